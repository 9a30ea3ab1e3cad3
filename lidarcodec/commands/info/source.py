"""`lidarcodec info SOURCE`: sensor, calibration, packets, frames, layouts, status, return mode."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from lidarcodec.assembly import Assembler
from lidarcodec.assembly.short_turns import ShortTurns
from lidarcodec.commands.info.explain import time_text
from lidarcodec.commands.progress import progress
from lidarcodec.commands.sources import is_endless
from lidarcodec.errors import SourceError
from lidarcodec.frame import Frame
from lidarcodec.packet_rest import PacketRest
from lidarcodec.sensor_model import SensorModel
from lidarcodec.sensors import StatusReader
from lidarcodec.sensors.clouds.sensor import cloud_evidence, has_points
from lidarcodec.sensors.models.table import sensor_of
from lidarcodec.sensors.recognise import STREAM_PACKETS, recognised
from lidarcodec.side import Role
from lidarcodec.sources import open_source
from lidarcodec.sources.spec import LIVE, Spec, parse
from lidarcodec.sources.table import SCHEMES, kind_of
from lidarcodec.sources.unit_calibration import remark_on
from lidarcodec.units import FRAME_PACKETS

LOOK_FRAMES = 10
"""Number of frames read from a source without an end."""
LOOK_PACKETS = 10 * LOOK_FRAMES * FRAME_PACKETS
"""Most packets read of it: some sensors have thousands in a turn."""
LOOK_CLOUDS = LOOK_FRAMES
"""The same for a source whose packets are point clouds."""
QUIET_S = 10.0
"""Default of the option `idle` here: `info` should not wait long for a live source that sends nothing."""
ROLE_LETTERS = {
    Role.IRREGULAR: "?",
    Role.UPPER_OPENS: "U",
    Role.UPPER_JOINS: "u",
    Role.LOWER_OPENS: "L",
    Role.LOWER_JOINS: "l",
    Role.UPPER_SECOND: "2",
    Role.LOWER_SECOND: "3",
}
"""A layout as twelve letters. A capital begins a column, a small letter continues it, 2 and 3 are second returns."""


class _Totals:
    """Totals over all frames."""

    def __init__(self) -> None:
        self.frames = self.columns = self.cells = self.points = 0
        self.first_ns: int | None = None
        self.last_ns = 0
        self.layouts: Counter[str] = Counter()
        self.longest_gap_ns = 0
        self.short = ShortTurns()

    def add_nothing(self, stamp_ns: int) -> None:
        """A message without points. A small bag may have a million, so no frame is made of it."""
        self.frames += 1
        self.layouts["odd"] += 1
        self._time(stamp_ns, stamp_ns, 0)

    def _time(self, first_ns: int, last_ns: int, longest_gap_ns: int) -> None:
        gap = 0 if self.first_ns is None else first_ns - self.last_ns
        self.longest_gap_ns = max(self.longest_gap_ns, gap, longest_gap_ns)
        self.first_ns = first_ns if self.first_ns is None else self.first_ns
        self.last_ns = last_ns

    def add(self, frame: Frame, fired_cells: int) -> None:
        side = frame.side
        self.short.add(frame)
        self.frames += 1
        self.columns += frame.width
        self.points += frame.points
        self.cells += fired_cells
        if side is None:
            return
        stamps = side.packet_ns + frame.stamp_ns
        self._time(int(stamps[0]), int(stamps[-1]), int(np.diff(stamps).max(initial=0)))
        if isinstance(side, PacketRest):
            self.layouts[side.layout or "odd"] += side.packets - len(side.odd) if side.layout else side.packets
            return
        for layout, count in enumerate(np.bincount(side.layout, minlength=len(side.layouts))):
            name = "".join(ROLE_LETTERS[Role(role)] for role in side.layouts[layout])
            self.layouts[name] += int(count)


def inspect_source(spec: str, calibration: Path | None) -> dict[str, Any]:
    """The contents of a source. All of it is read, or ten frames if it has no end.

    Raises SourceError, also if a live source sends nothing, PacketError or CalibrationError.
    """
    limit = (LOOK_CLOUDS if parse(spec).scheme == "ros2" else LOOK_PACKETS) if is_endless(spec) else None
    quiet_s = parse(spec).number("idle", 0.0, 1e9) or QUIET_S
    totals, status = _Totals(), StatusReader()
    packets = positions = 0
    first: list[bytes] = []
    repeated = 0
    before: bytes | None = None
    with (
        open_source(_limited(parse(spec, SCHEMES)), calibration=calibration, points=False) as source,
        progress("reading packets") as tick,
    ):
        sensor = source.sensor
        assembler = Assembler(sensor)
        for packet in source.packets():
            frame = None
            if sensor.is_cloud and not packet.position:
                repeated, before = repeated + (packet.payload == before), packet.payload
            if sensor.is_cloud and not packet.position and not has_points(packet.payload):
                totals.add_nothing(packet.stamp_ns)
            else:
                frame = assembler.push(packet)
            if packet.position:
                positions += 1
                continue
            packets += 1
            if sensor.is_hdl64e:
                status.push(packet.payload)
            if len(first) < (1 if sensor.is_cloud else STREAM_PACKETS):
                first.append(packet.payload)
            if frame is not None:
                totals.add(frame, _cells(frame))
            tick()
            if packets == limit or (limit is not None and totals.frames == LOOK_FRAMES):
                break
        last = assembler.flush()
        if last is not None and (limit is None or totals.frames < LOOK_FRAMES):
            totals.add(last, _cells(last))
        if sensor.is_cloud:  # the assembler does not see messages without points
            assembler.counts["repeated packets"] = repeated
        noticed = source.counts + assembler.counts
        if source.live and not packets + positions:
            besides = "".join(f", {count} {cause}" for cause, count in sorted(noticed.items()))
            raise SourceError(
                f"{source.label}: no packet arrived within {quiet_s:g} s{besides}. Check that the sensor is on and "
                "sends to this address. ?idle=60 waits for 60 s"
            )
        path = parse(spec).path if kind_of(parse(spec, SCHEMES)) in ("capture", "recording") else None
        remark = remark_on(sensor, path, live=source.live)
        label, fidelity = source.label, getattr(source, "fidelity", None)
    del noticed["packets"], noticed["frames"], noticed["position packets"]
    duration_s = (totals.last_ns - (totals.first_ns or 0)) * 1e-9
    found: dict[str, Any] = {
        "source": spec + (f" (the first {packets} packets: it has no end)" if limit else ""),
        "what": label,
        "sensor": sensor.name,
        "model": sensor.model,
        **_about(sensor, first),
        "calibration": {"origin": sensor.origin, "hash": sensor.hash},
        **({"note": remark} if remark else {}),
        "packets": packets,
        **({"position packets": positions} if positions else {}),
        "frames": totals.frames,
        "begins": time_text(totals.first_ns) if totals.first_ns is not None else "never",
        "duration_s": round(duration_s, 3),
        "packets_per_s": round((packets - 1) / duration_s, 1) if duration_s > 0 else None,
        "longest_gap_ms": round(totals.longest_gap_ns * 1e-6, 3),
        "columns": totals.columns,
        "points": totals.points,
        "returns_percent": round(100 * totals.points / totals.cells, 2) if totals.cells else None,
        "layouts": dict(totals.layouts.most_common()),
        **(
            {"return_mode": _return_mode(status, totals.layouts), "status": _status(status)} if sensor.is_hdl64e else {}
        ),
        **_short_turns(totals.short),
        "noticed": dict(noticed + _missing(totals.short)),
    }
    if fidelity is not None:
        found["fidelity"] = [one.rounded() for one in fidelity]
    return found


def _short_turns(found: ShortTurns) -> dict[str, Any]:
    """Turns that lack columns, and what the sensor is set not to send. Empty where all columns are there."""
    rows = found.rows()
    told = [
        {
            "turn": row.turn,
            "columns": row.columns,
            "missing": row.missing,
            "gaps_deg": ", ".join(f"{begin:g} to {end:g}" for begin, end in row.gaps),
            **({"turns_before": row.turns_before} if any(one.turns_before for one in rows) else {}),
        }
        for row in rows
    ]
    unsent = ", ".join(f"{begin:g} to {end:g} degrees of each turn" for begin, end in found.unsent())
    return ({"not_sent": unsent} if unsent else {}) | ({"short_turns": told} if told else {})


def _missing(found: ShortTurns) -> Counter[str]:
    """What turns lack, among the irregularities that were noticed."""
    rows = found.rows()
    return Counter(
        {
            "turns that lack columns": sum(row.missing > 0 for row in rows),
            "missing columns": sum(row.missing for row in rows),
            "missing turns": sum(row.turns_before for row in rows),
        }
    )


def _cells(frame: Frame) -> int:
    """Number of fired cells."""
    return int(np.count_nonzero(frame.fired)) * (frame.sensor.rows // 2) if frame.sensor.rows > 1 else frame.width


def _about(sensor: SensorModel, payloads: list[bytes]) -> dict[str, Any]:
    """Facts about a sensor: rows, range step, planes, and the evidence for its model."""
    if sensor.is_hdl64e:
        seen = recognised(payloads) if payloads else None
        evidence = seen.evidence if seen is not None and seen.model == sensor.model else "named by --model"
        facts = {"rows": sensor.rows, "range_step_m": sensor.range_step_m, "planes": "range intensity"}
        return {"evidence": evidence, **facts}
    if sensor.is_cloud:
        evidence = next((found for payload in payloads if (found := cloud_evidence(payload))), "named by --model")
        return {"evidence": evidence, "rows": sensor.rows}
    family = sensor_of(sensor)
    if family is None:
        return {"evidence": "its packets are kept unchanged, without images or points"}
    layouts = [layout for payload in payloads if (layout := family.layout_of(payload)) is not None]
    return {
        "evidence": next((found for payload in payloads if (found := family.evidence(payload))), "named by --model"),
        "rows": sensor.rows,
        "range_step_m": sensor.range_step_m,
        "planes": " ".join(plane.name for plane in layouts[0].planes) if layouts else "",
    }


def _limited(spec: Spec) -> Spec:
    """The source with an option `idle`, if it is a live source without one. Errors show it as it was written."""
    if spec.scheme not in LIVE or "idle" in spec.options:
        return spec
    return replace(spec, options={**spec.options, "idle": f"{QUIET_S:g}"})


def _return_mode(status: StatusReader, layouts: Counter[str]) -> str:
    if any("2" in layout or "3" in layout for layout in layouts):
        return "dual (second returns in the packets)"
    if status.unit is not None:
        modes = ("strongest", "last", "dual")
        return modes[status.unit.return_mode] if status.unit.return_mode < len(modes) else "unknown"
    return "single (no second returns in the packets)"


def _status(status: StatusReader) -> dict[str, Any]:
    found: dict[str, Any] = {}
    if "V" in status.values:
        found["firmware"] = f"{status.values['V']:#04x}"
    if "T" in status.values:
        found["temperature_c"] = status.values["T"]
    if status.clock is not None:
        clock = status.clock
        date, hour = (clock.year, clock.month, clock.day), (clock.hour, clock.minute, clock.second)
        found["clock"] = "{:04d}-{:02d}-{:02d} {:02d}:{:02d}:{:02d}".format(*date, *hour)
    if status.sensor is not None:
        found["calibration in the stream"] = status.sensor.hash
    if status.unit is not None:
        found.update(rpm=status.unit.rpm, hours=status.unit.hours, power_level=status.unit.power_level)
    return found

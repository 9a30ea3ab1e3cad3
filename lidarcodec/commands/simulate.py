"""`lidarcodec simulate`: writes a simulated drive as a capture."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from lidarcodec.commands.progress import progress
from lidarcodec.commands.running import remaining
from lidarcodec.commands.running.stopping import stoppable
from lidarcodec.commands.running.telling import tell
from lidarcodec.commands.sources import check_finite
from lidarcodec.commands.turns import Turns, turns_of
from lidarcodec.errors import SettingsError, SourceError
from lidarcodec.files.whole import check_free, whole
from lidarcodec.sensor_model import SensorModel
from lidarcodec.sensors import db_xml
from lidarcodec.sources.captures.pcap_writer import PcapWriter
from lidarcodec.sources.simulator import SCENES, SimulatorSource
from lidarcodec.units import counted


def run(spec: str, out: Path, frames: int | None, skip: int = 0, force: bool = False, as_json: bool = False) -> None:
    """Write the packets, and next to them the description of the simulated sensor, where readers find it."""
    if not spec.startswith("sim:"):
        raise SettingsError(f"simulate needs one of sim:{', sim:'.join(SCENES)}, not {spec}")
    if out.suffix.lower() != ".pcap":
        raise SettingsError(f"simulate writes a capture: {out} must end in .pcap")
    check_finite(spec, frames)
    check_free(out, force=force)
    with SimulatorSource.from_spec(spec) as source, stoppable() as stopped:
        ending, text = _description(source.sensor)
        if text:
            check_free(_described_in(out, ending), force=force)
        with whole(out, force=force) as output, progress("simulating", frames) as tick:
            described = bool(text) and not output.straight
            if described:
                name_of = partial(_described_in, ending=ending)
                output.companion(name_of, Path(ending).suffix).write_text(text, encoding="utf-8")
            turns = Turns(source.packets(), stopped, tick, None, frames, turns_of(source.sensor))
            turns.pass_over(skip)
            with output.beside.open("wb") as handle:
                PcapWriter(handle).write_all(turns)
            if turns.packets == 0 and turns.cut:
                raise remaining.stopped(out, None, 0)
            if turns.packets == 0:
                raise SourceError(f"{spec} has no packet after the first {skip} frames: {out} was not written")
            if turns.cut:
                output.only_part()
    count, kept = turns.packets, output.kept
    what = "calibration" if source.sensor.is_hdl64e else "metadata"
    beside = [str(_described_in(kept, ending))] if described and kept is not None else []
    tell(
        {"output": str(kept), "beside": beside, "packets": count, "frames": turns.turns},
        f"{kept}: {counted(count, 'packet')}, {counted(turns.turns, 'frame')}"
        + "".join(f"; {what} in {path}" for path in beside),
        as_json,
    )
    if turns.cut:
        raise remaining.stopped(out, kept, turns.turns, skip=skip, frames=frames)


def _description(sensor: SensorModel) -> tuple[str, str]:
    """What the name of the file beside the capture ends with, and its text; an empty text if there is none.

    A Velodyne or Hesai beside the HDL-64E has the nominal calibration of its model.
    """
    if sensor.is_hdl64e:
        return "_db.xml", db_xml.text(sensor.calibration)
    return ".json", sensor.description.decode()


def _described_in(out: Path, ending: str) -> Path:
    return out.with_name(out.stem + ending)

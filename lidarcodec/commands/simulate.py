"""`lidarcodec simulate`: a simulated drive as a capture."""

from __future__ import annotations

from itertools import islice
from pathlib import Path

from lidarcodec.commands.progress import progress
from lidarcodec.commands.running import remaining
from lidarcodec.commands.running.stopping import stoppable
from lidarcodec.commands.sources import check_finite
from lidarcodec.commands.turns import Turns
from lidarcodec.errors import SettingsError, SourceError
from lidarcodec.files.whole import check_free, whole
from lidarcodec.sensors import db_xml
from lidarcodec.sources import open_source
from lidarcodec.sources.captures.pcap_writer import PcapWriter
from lidarcodec.units import FRAME_PACKETS


def run(spec: str, out: Path, frames: int | None, skip: int = 0, force: bool = False) -> None:
    """Write the packets, and the calibration of the simulated sensor beside them, where every reader finds it."""
    if not spec.startswith("sim:"):
        raise SettingsError(f"simulate needs sim:city, sim:road, sim:street, sim:bend or sim:motorway, not {spec}")
    if out.suffix.lower() != ".pcap":
        raise SettingsError(f"simulate writes a capture: {out} must end in .pcap")
    check_finite(spec, frames)
    check_free(out, force=force)
    check_free(_calibration_of(out), force=force)
    with (
        open_source(spec) as source,
        stoppable() as stopped,
        whole(out, force=force) as output,
        progress("simulating", frames) as tick,
    ):
        if not output.straight:
            output.companion(_calibration_of, ".xml").write_text(
                db_xml.text(source.sensor.calibration), encoding="utf-8"
            )
        limit = None if frames is None else (skip + frames) * FRAME_PACKETS
        packets = islice(source.packets(), limit)
        turns = Turns(packets, stopped, tick)
        turns.pass_over(skip)
        with output.beside.open("wb") as handle:
            PcapWriter(handle).write_all(turns)
        if turns.packets == 0 and turns.cut:
            raise remaining.stopped(out, None, 0)
        if turns.packets == 0:
            raise SourceError(f"{spec} has no packet after the first {skip} frames: {out} was not written")
        if turns.cut:
            output.only_part()
    count = turns.packets
    beside = "" if output.straight or output.kept is None else f"; calibration in {_calibration_of(output.kept)}"
    print(f"{output.kept}: {count} packets, {count / FRAME_PACKETS:.1f} frames{beside}")
    if turns.cut:
        raise remaining.stopped(out, output.kept, count // FRAME_PACKETS, skip=skip, frames=frames)


def _calibration_of(out: Path) -> Path:
    return out.with_name(f"{out.stem}_db.xml")

"""`lidarcodec simulate`: a simulated drive as a capture."""

from __future__ import annotations

from itertools import islice
from pathlib import Path

from lidarcodec.commands.progress import progress
from lidarcodec.commands.sources import check_finite
from lidarcodec.commands.stopping import stoppable
from lidarcodec.errors import SettingsError
from lidarcodec.sensors import write_db_xml
from lidarcodec.sources import open_source
from lidarcodec.sources.pcap_writer import PcapWriter
from lidarcodec.units import FRAME_PACKETS


def run(spec: str, out: Path, frames: int | None) -> None:
    """Write the packets, and the calibration of the simulated sensor beside them, where every reader finds it."""
    if not spec.startswith("sim:"):
        raise SettingsError(f"simulate takes sim:city, sim:road, sim:street, sim:bend or sim:motorway, not {spec}")
    if out.suffix.lower() != ".pcap":
        raise SettingsError(f"simulate writes a capture: let {out} end in .pcap")
    check_finite(spec, frames)
    limit = None if frames is None else frames * FRAME_PACKETS
    packets = 0
    with (
        open_source(spec) as source,
        out.open("wb") as handle,
        progress("simulating", limit) as tick,
        stoppable() as stopped,
    ):
        writer = PcapWriter(handle)
        beside = out.with_name(f"{out.stem}_db.xml")
        write_db_xml(source.sensor, beside)
        for packet in islice(source.packets(), limit):
            writer.write(packet)
            packets += 1
            tick()
            if stopped():
                break
    print(f"{out}: {packets} packets, {packets / FRAME_PACKETS:.1f} frames; calibration in {beside}")

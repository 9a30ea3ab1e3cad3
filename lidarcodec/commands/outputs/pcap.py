"""Packets, as the sensor sent them (.pcap)."""

from __future__ import annotations

from pathlib import Path

from lidarcodec.assembly import packets_of
from lidarcodec.commands.outputs.base import Cloud
from lidarcodec.errors import SettingsError
from lidarcodec.frame import Frame
from lidarcodec.sources.captures.pcap_writer import PcapWriter


class PcapOutput:
    """Writes the packets as the sensor sent them, with their host times. packets: how many so far"""

    def __init__(self, path: Path) -> None:
        self.packets = 0
        self._handle = path.open("wb")
        self._writer = PcapWriter(self._handle)

    def write(self, frame: Frame, cloud: Cloud) -> None:
        if frame.sensor.is_cloud:
            raise SettingsError("a capture cannot hold point clouds: write .mcap, .npz, .ply or .las")
        for packet in packets_of(frame):
            self._writer.write(packet)
            self.packets += 1

    def close(self) -> None:
        self._handle.close()

"""Turns of a sensor among frames that may be parts of one, for its bitrate."""

from __future__ import annotations

from collections.abc import Sequence

from lidarcodec.assembly.any_sensor import TurnWatch
from lidarcodec.assembly.assembler import TURN_NS
from lidarcodec.frame import Frame
from lidarcodec.sensors.models.table import PACKETS
from lidarcodec.settings import settings_from


class Turns:
    """Counts the turns of another sensor than an HDL-64E. Where frames are no slabs each is one, or the rest of one.

    count: turns that were begun so far
    """

    def __init__(self, framing: str) -> None:
        self.count = 0
        self._slabs = framing != "packets" and settings_from({"framing": framing}).frame_packets is not None
        self._watch: TurnWatch | None = None
        self._begin_ns: int | None = None

    def add(self, frame: Frame, payloads: Sequence[bytes]) -> None:
        """Take a frame. payloads: of its packets"""
        if not self._slabs or frame.sensor.is_cloud or frame.side is None:
            self.count += 1
        elif frame.sensor.model == PACKETS:
            for stamp_ns in (frame.stamp_ns + frame.side.packet_ns).tolist():
                if self._begin_ns is None or not 0 <= stamp_ns - self._begin_ns < TURN_NS:
                    self._begin_ns = stamp_ns
                    self.count += 1
        else:
            if self._watch is None:
                self._watch, self.count = TurnWatch(frame.sensor), 1
            self.count += sum(map(self._watch.begins, payloads))

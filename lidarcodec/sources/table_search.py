"""Search for the sensor's calibration table in the status bytes of a stream.

The table takes 4160 packets. Seven of sixteen packets carry a part of it, so 64 packets are enough to see whether a
stream has one.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from lidarcodec.sensor_model import SensorModel
from lidarcodec.sensors import STATUS_PACKETS, StatusReader

FIRST_PACKETS: Final = 64
PARAMETER_TYPES: Final = frozenset(b"1234567")
"""Status types that carry the table."""
SEARCHED_PACKETS: Final = 2 * STATUS_PACKETS
"""Packets that hold the whole table if none is lost, wherever the stream begins."""


def carries_table(payloads: Sequence[bytes]) -> bool:
    """Whether the first payloads of a stream show a part of a table."""
    return any(payload[-2] in PARAMETER_TYPES for payload in payloads[:FIRST_PACKETS])


class TableSearch:
    """Looks for the calibration table of a live stream.

    first: the first payloads;  settled: the search is over;  sensor: the one found, or None
    """

    def __init__(self) -> None:
        self._reader = StatusReader()
        self._seen = 0
        self.first: list[bytes] = []
        self.settled = False
        self.sensor: SensorModel | None = None

    def push(self, payload: bytes) -> bool:
        """Take the next packet; False when the search is over. A stream with losses is searched twice as long."""
        self._seen += 1
        if self._seen <= FIRST_PACKETS:
            self.first.append(payload)
            if self._seen == FIRST_PACKETS and not carries_table(self.first):
                self.settled = True
        if self._reader.push(payload):
            self.sensor = self._reader.sensor
        over = self.sensor is not None or self._seen >= 2 * SEARCHED_PACKETS
        self.settled |= over
        return not over

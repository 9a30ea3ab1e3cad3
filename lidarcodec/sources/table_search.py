"""Whether a stream carries its sensor's calibration table in the status bytes, and the table when it has come round.

The table takes 4160 packets; a stream that has one shows it in seven of sixteen packets, so the first 64 tell whether
it is worth reading on.
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
"""Packets within which a table without gaps has come round, wherever the stream begins."""


def carries_table(payloads: Sequence[bytes]) -> bool:
    """Whether the first payloads of a stream show a part of a table."""
    return any(payload[-2] in PARAMETER_TYPES for payload in payloads[:FIRST_PACKETS])


class TableSearch:
    """Looks for the calibration table of a live stream.

    first: the first payloads;  settled: nothing is to be waited for any more;  sensor: what was found
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

"""Messages of a topic as packets: a message is one."""

from __future__ import annotations

from collections import Counter

from lidarcodec.errors import DecodeError
from lidarcodec.packet import Packet
from lidarcodec.sensors.clouds.message import MAX_MESSAGE, read_head


class CloudPackets:
    """Gives messages the time of their header. One that has none, because it is no PointCloud2, gets that of the one
    before. counts: `too long`, messages of more than 32 MiB, which are left out
    """

    def __init__(self, counts: Counter[str]) -> None:
        self._counts, self._last_ns = counts, 0

    def of(self, payload: bytes) -> list[Packet]:
        """The packet of a message, if it is not too long."""
        if len(payload) > MAX_MESSAGE:
            self._counts["too long"] += 1
            return []
        try:
            self._last_ns = read_head(payload).stamp_ns
        except DecodeError:
            self._counts["no clouds"] += 1
        return [Packet(payload, self._last_ns)]

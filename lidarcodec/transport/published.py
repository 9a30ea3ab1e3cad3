"""Which streams have a publisher now, by their tokens."""

from __future__ import annotations

import time
from typing import Final

from lidarcodec.errors import LidarCodecError
from lidarcodec.transport.base import Transport
from lidarcodec.transport.keys import PREFIX, StreamKeys

WAIT_S: Final = 0.3
MOST: Final = 1000
"""Further ones are left out: anybody on the network can have tokens."""


def published(transport: Transport, wait_s: float = WAIT_S) -> list[str]:
    """The streams `VEHICLE/SENSOR` of all publishers that this session sees within the time, sorted.

    Raises TransportError.
    """
    found: dict[str, None] = {}

    def came(key: str, alive: bool) -> None:
        if alive and len(found) < MOST:
            found[key.rpartition("/")[0]] = None

    watching = transport.watch(f"{PREFIX}/*/*/alive", came)
    time.sleep(wait_s)
    watching.close()
    return sorted(filter(None, map(_name, found)))


def _name(key: str) -> str:
    try:
        keys = StreamKeys.parse(key)
    except LidarCodecError:  # a name that no publisher has
        return ""
    return f"{keys.vehicle}/{keys.sensor}"


__all__ = ["published"]

"""Namesake: notices another publisher of the same name, by its statuses on the key that both have."""

from __future__ import annotations

import logging
from typing import Final

from lidarcodec.apps.reports import read_status
from lidarcodec.transport.keys import StreamKeys
from lidarcodec.untrusted.json import JsonRefusedError

logger = logging.getLogger(__name__)

SURE: Final = 2
"""So many statuses of the other one must come: a single one may be the last of a publisher that has just ended."""


class Namesake:
    """Warns once. A transport does not deliver the own statuses, and the stream id tells a restart from a second one.

    >>> namesake = Namesake(StreamKeys("car-7", "roof"), stream_id=7)
    >>> for _ in range(2):
    ...     namesake.told(b'{"stream_id": "0000000000000008", "ended": false}')
    >>> namesake.found
    True
    """

    def __init__(self, keys: StreamKeys, stream_id: int) -> None:
        """stream_id: of this publisher"""
        self._keys, self._own = keys, f"{stream_id:016x}"
        self._other: object = None
        self._seen = 0
        self.found = False

    def told(self, data: bytes) -> None:
        """A status came on the key of this stream. Nothing is read after the warning."""
        if self.found:
            return
        try:
            status = read_status(data)
        except JsonRefusedError:
            return
        other = status.get("stream_id")
        if not isinstance(other, str) or other == self._own or status.get("ended"):
            return
        self._seen = self._seen + 1 if other == self._other else 1
        self._other = other
        if self._seen == SURE:
            self.found = True
            logger.warning(
                "another publisher sends as %s/%s, too, so receivers get both in turn: end it, or give one of them "
                "another name with --vehicle or --sensor",
                self._keys.vehicle,
                self._keys.sensor,
            )


__all__ = ["Namesake"]

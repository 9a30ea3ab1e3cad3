"""Admission: which refinements of a live stream are taken, recorded and reported.

Those of messages that came, each once, and few of a sector: others may send on the same key, and what fits is known
only when the base is decoded. A refinement that comes before its message waits for it.
"""

from __future__ import annotations

from collections import OrderedDict, deque
from dataclasses import dataclass, field
from typing import Final

from lidarcodec.layers import SECTORS, Refinement
from lidarcodec.message import Message
from lidarcodec.recording.refinements import OF_SECTOR
from lidarcodec.units import LASERS
from lidarcodec.wire import checksum_of

MESSAGES: Final = 64
"""Newest messages whose refinements are taken."""
EARLY: Final = 24
EARLY_BYTES: Final = 8 * 2**20
"""Most refinements that wait for their messages, and their bytes."""
CELL_BYTES, SECTOR_BYTES = 4, 256
"""Most bytes of the refinements of a frame, for each of its cells and each sector: more than all exact values take."""
Of = tuple[int, int]


@dataclass
class _Frame:
    """room: bytes that may still come;  sectors: checksums of the refinements of each"""

    room: int
    sectors: dict[int, set[int]] = field(default_factory=dict)


class Admission:
    """Refinements that may be taken. Not thread-safe."""

    def __init__(self) -> None:
        self._came: OrderedDict[Of, _Frame] = OrderedDict()
        self._early: deque[tuple[Of, bytes]] = deque()
        self._early_bytes = 0

    def message(self, message: Message) -> list[bytes]:
        """A message came. Returns the refinements that waited for it."""
        of = message.stream_id, message.frame_index
        if of in self._came:
            return []
        self._came[of] = _Frame(CELL_BYTES * LASERS * message.width + SECTOR_BYTES * SECTORS)
        if len(self._came) > MESSAGES:
            self._came.popitem(last=False)
        found = [data for other, data in self._early if other == of]
        if found:
            self._early = deque(one for one in self._early if one[0] != of)
            self._early_bytes -= sum(map(len, found))
        return found

    def admits(self, one: Refinement, data: bytes) -> bool | None:
        """Whether a refinement is to be taken. None: it waits for its message."""
        of = one.stream_id, one.frame_index
        frame = self._came.get(of)
        if frame is None:
            self._early.append((of, data))
            self._early_bytes += len(data)
            while len(self._early) > EARLY or self._early_bytes > EARLY_BYTES:
                self._early_bytes -= len(self._early.popleft()[1])
            return None
        known, checksum = frame.sectors.setdefault(one.sector, set()), checksum_of(data)
        if checksum in known or len(known) >= OF_SECTOR or len(data) > frame.room:
            return False
        known.add(checksum)
        frame.room -= len(data)
        return True

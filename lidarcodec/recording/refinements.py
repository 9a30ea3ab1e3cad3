"""Refinements: those that a reader or a receiver came across, until their messages are decoded.

A recorder writes refinements after their base, and at most a few messages later. A reader sorts messages and so gives
each a few messages late; by then its refinements were read.

Which of them fit is known when the base is decoded. So several of a sector are kept, and others cannot take the place
of the right one by coming first; one that came twice is kept once.
"""

from __future__ import annotations

from collections import OrderedDict
from typing import Final

from lidarcodec.errors import DecodeError
from lidarcodec.layers import peek_refinement
from lidarcodec.message import Message

_MAX_FRAMES: Final = 64
"""Frames whose refinements are kept: more than a reader sorts messages."""
_MAX_BYTES: Final = 64 * 2**20
"""Most bytes of all that are kept. A turn's refinements have 0.1 MB."""
OF_SECTOR: Final = 4
"""Most refinements of a sector that are kept."""


class Refinements:
    """Refinements by stream and frame. The oldest frames are left out where too much would be kept.

    unread: refinements that are damaged, or whose frame did not come in time
    came, came_bytes: all that came, taken or not, and their bytes
    """

    def __init__(self) -> None:
        self._of: OrderedDict[tuple[int, int], list[tuple[int, bytes]]] = OrderedDict()
        self._bytes = 0
        self.unread = self.came = self.came_bytes = 0

    def clear(self) -> None:
        """Forget all."""
        self._of.clear()
        self._bytes = self.unread = self.came = self.came_bytes = 0

    def put(self, data: bytes) -> None:
        """Keep a refinement, of bytes that nobody has looked at."""
        self.came, self.came_bytes = self.came + 1, self.came_bytes + len(data)
        try:
            head = peek_refinement(data)
        except DecodeError:
            self.unread += 1
            return
        of_frame = self._of.setdefault((head.stream_id, head.frame_index), [])
        of_sector = [one for sector, one in of_frame if sector == head.sector]
        if data in of_sector:
            return
        if len(of_sector) >= OF_SECTOR:
            self.unread += 1
            return
        of_frame.append((head.sector, data))
        self._bytes += len(data)
        while len(self._of) > _MAX_FRAMES or self._bytes > _MAX_BYTES:
            _, left_out = self._of.popitem(last=False)
            self._bytes -= sum(len(data) for _, data in left_out)
            self.unread += len(left_out)

    def untaken(self) -> int:
        """How many refinements nobody took, `unread` ones included."""
        return self.unread + sum(map(len, self._of.values()))

    def take(self, message: Message) -> list[bytes]:
        """The refinements of a message's frame, which are then kept no longer."""
        found = [data for _, data in self._of.pop((message.stream_id, message.frame_index), [])]
        self._bytes -= sum(map(len, found))
        return found

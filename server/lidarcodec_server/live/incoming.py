"""What a client sends on a WebSocket, cut into frames and counted before anything parses it.

A frame of six bytes takes a parser in Python as long as a hundred bytes of anything else, so a connection without a
limit on frames can keep a processor busy. Fragments, pings and pongs are frames as messages are.

>>> frames = Frames()
>>> frames.feed(bytes([0x81, 0x83]) + b"mask" + b"ack" + bytes([0x89, 0x80]) + b"ma")
>>> frames.take().cost, frames.take()
(1, None)
>>> frames.feed(b"sk")
>>> frames.take().data
b'\\x89\\x80mask'
"""

from __future__ import annotations

from typing import Final, NamedTuple

BYTES_A_FRAME: Final = 512
"""A frame counts once, and once more for each so many bytes of its payload."""
_LENGTHS: Final = {126: 2, 127: 8}
"""RFC 6455, 5.2: the length in the second byte that says how many bytes hold the length itself."""
_MASK: Final = 4


class Piece(NamedTuple):
    """Bytes of one frame.

    cost: frames that these bytes count as, 0 for more of a payload that has begun
    part: whether a part of a message begins here that neither begins nor ends it
    """

    data: bytes
    cost: int = 0
    part: bool = False


class Frames:
    """Cuts what comes into frames; what it does not understand is left to the parser behind it."""

    def __init__(self) -> None:
        self._kept = bytearray()
        self._payload_left = 0

    def feed(self, data: bytes) -> None:
        """Keep bytes that came."""
        self._kept += data

    def clear(self) -> None:
        """Throw away what is kept."""
        self._kept.clear()

    def take(self) -> Piece | None:
        """The next frame, or as much of it as came; None while there is nothing to go on with."""
        if self._payload_left:
            return self._cut(self._payload_left) if self._kept else None
        head = self._head()
        if head is None:
            return None
        size, payload = head
        final, opcode = self._kept[0] & 0x80, self._kept[0] & 0x0F
        piece = self._cut(size + payload)
        return piece._replace(cost=1 + payload // BYTES_A_FRAME, part=opcode == 0 and not final)

    def _cut(self, wanted: int) -> Piece:
        data = bytes(self._kept[:wanted])
        del self._kept[:wanted]
        self._payload_left = wanted - len(data)
        return Piece(data)

    def _head(self) -> tuple[int, int] | None:
        """Bytes of the head and of the payload; None while the head is not whole."""
        if len(self._kept) < 2:
            return None
        short = self._kept[1] & 0x7F
        extra = _LENGTHS.get(short, 0)
        size = 2 + extra + (_MASK if self._kept[1] & 0x80 else 0)
        if len(self._kept) < size:
            return None
        return size, int.from_bytes(self._kept[2 : 2 + extra], "big") if extra else short

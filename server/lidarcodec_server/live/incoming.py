"""Splits the bytes that a client sends on a WebSocket into frames, and counts them before they are parsed.

A parser in Python needs as long for a frame of six bytes as for a hundred bytes of payload. So without a limit on
frames a connection could keep a processor busy. Fragments, pings and pongs are frames, too.

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
"""A frame counts once, and once more for every so many bytes of its payload."""
_LENGTHS: Final = {126: 2, 127: 8}
"""RFC 6455, 5.2: values of the length in the second byte, and the size in bytes of the length that then follows."""
_MASK: Final = 4


class Piece(NamedTuple):
    """Bytes of one frame.

    cost: number of frames for which these bytes count; 0 for the rest of a payload
    part: whether they begin a middle fragment of a message
    """

    data: bytes
    cost: int = 0
    part: bool = False


class Frames:
    """Splits received bytes into frames. It leaves invalid bytes to the parser after it."""

    def __init__(self) -> None:
        self._kept = bytearray()
        self._payload_left = 0

    def feed(self, data: bytes) -> None:
        """Add received bytes."""
        self._kept += data

    def clear(self) -> None:
        """Discard all bytes."""
        self._kept.clear()

    def take(self) -> Piece | None:
        """The next frame, or the part of it that has arrived; None if more bytes are needed first."""
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
        """Sizes of head and payload in bytes; None while the head is incomplete."""
        if len(self._kept) < 2:
            return None
        short = self._kept[1] & 0x7F
        extra = _LENGTHS.get(short, 0)
        size = 2 + extra + (_MASK if self._kept[1] & 0x80 else 0)
        if len(self._kept) < size:
            return None
        return size, int.from_bytes(self._kept[2 : 2 + extra], "big") if extra else short

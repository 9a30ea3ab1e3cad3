"""CDR, the form of ROS 2's messages (OMG DDS-XTypes 7.4.3, plain, version 1): little endian out, either one in.

Values lie at multiples of their size, counted from behind the four bytes that say which form it is.

>>> CdrWriter().u32(7).text("map").done().hex(" ")
'00 01 00 00 07 00 00 00 04 00 00 00 6d 61 70 00'
"""

from __future__ import annotations

import struct
from typing import Final, Self

from lidarcodec.errors import SectionError, TruncatedError

LITTLE_ENDIAN: Final = b"\0\1\0\0"
_BIG, _LITTLE = 0, 1


class CdrWriter:
    """Values of a message as they are added."""

    def __init__(self) -> None:
        self._parts: list[bytes] = []
        self._size = 0

    def raw(self, data: bytes) -> Self:
        """Bytes as they are."""
        self._parts.append(data)
        self._size += len(data)
        return self

    def align(self, size: int) -> Self:
        """Zeros up to the next multiple of `size`."""
        return self.raw(bytes(-self._size % size))

    def u8(self, value: int) -> Self:
        """An octet, or a truth."""
        return self.raw(struct.pack("<B", value))

    def i32(self, value: int) -> Self:
        """A whole number."""
        return self.align(4).raw(struct.pack("<i", value))

    def u32(self, value: int) -> Self:
        """A whole number that is not negative."""
        return self.align(4).raw(struct.pack("<I", value))

    def f64(self, value: float) -> Self:
        """A number."""
        return self.align(8).raw(struct.pack("<d", value))

    def text(self, value: str) -> Self:
        """A text, with the zero that ends it."""
        data = value.encode() + b"\0"
        return self.u32(len(data)).raw(data)

    def stamp(self, stamp_ns: int) -> Self:
        """`builtin_interfaces/Time`; a time beyond its 32 bits of seconds is the nearest within."""
        seconds, nanos = divmod(stamp_ns, 10**9)
        return self.i32(min(max(seconds, -(2**31)), 2**31 - 1)).u32(nanos)

    def header(self, stamp_ns: int, frame_id: str) -> Self:
        """`std_msgs/Header`."""
        return self.stamp(stamp_ns).text(frame_id)

    def done(self) -> bytes:
        """The message."""
        return b"".join((LITTLE_ENDIAN, *self._parts))


class CdrReader:
    """Values of a message as they are asked for; at: where the next one is, counted from behind the form."""

    def __init__(self, data: bytes) -> None:
        """Raises SectionError for a form other than plain CDR."""
        if len(data) < 4 or data[0] != 0 or data[1] not in (_BIG, _LITTLE):
            raise SectionError(f"a message that begins with {data[:4].hex(' ') or 'nothing'} is not in plain CDR")
        self.order = "<" if data[1] == _LITTLE else ">"
        self._data = memoryview(data)[4:]
        self.at = 0

    @property
    def left(self) -> int:
        """Bytes that are left."""
        return len(self._data) - self.at

    def align(self, size: int) -> None:
        """Go to the next multiple of `size`."""
        self.at += -self.at % size

    def raw(self, size: int) -> memoryview:
        """So many bytes.

        Raises TruncatedError where they are not there.
        """
        if not 0 <= size <= self.left:
            raise TruncatedError(f"a CDR message needs {size} bytes where {max(self.left, 0)} are left", self.at + 4)
        self.at += size
        return self._data[self.at - size : self.at]

    def i32(self) -> int:
        """A whole number."""
        self.align(4)
        return int(struct.unpack(self.order + "i", self.raw(4))[0])

    def u32(self) -> int:
        """A whole number that is not negative."""
        self.align(4)
        return int(struct.unpack(self.order + "I", self.raw(4))[0])

    def text(self) -> str:
        """A text; what is not UTF-8 in it becomes escapes."""
        return bytes(self.raw(self.u32())).rstrip(b"\0").decode("utf-8", "backslashreplace")

    def stamp(self) -> int:
        """`builtin_interfaces/Time` in ns."""
        return self.i32() * 10**9 + self.u32()

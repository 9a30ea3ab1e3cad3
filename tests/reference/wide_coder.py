"""The coder of decisions in words of four bytes, in pure Python: same bytes as native/src/bits/wide_coder.hpp."""

from __future__ import annotations

from typing import Final

from lidarcodec.errors import SectionError, TruncatedError

WINDOW: Final = 1 << 64
MOVE: Final = 1 << 32


def end_of(low: int, extent: int) -> tuple[int, int]:
    """The value that names the interval from `low` on in the fewest bytes, and how many these are."""
    for count in range(5):
        unit = 1 << (64 - 8 * count)
        value = -(-low // unit) * unit
        if value - low < extent:
            return value, count
    raise AssertionError("four bytes always suffice")


class WideWriter:
    """Writes the decisions of one half of each row."""

    def __init__(self) -> None:
        self._value, self._words, self._range = 0, 0, WINDOW - 1  # all bits so far, as one number

    def bit(self, bit: int, probability: int) -> int:
        """Write one decision."""
        bound = (self._range >> 15) * probability
        if bit:
            self._range = bound
        else:
            self._value += bound
            self._range -= bound
        if self._range < MOVE:
            self._value, self._words, self._range = self._value << 32, self._words + 1, self._range << 32
        return bit

    def plain(self, value: int, bits: int) -> int:
        """Write equally likely bits."""
        self._range >>= bits
        self._value += self._range * value
        if self._range < MOVE:
            self._value, self._words, self._range = self._value << 32, self._words + 1, self._range << 32
        return value

    def finish(self) -> bytes:
        """All bytes."""
        value, count = end_of(self._value, self._range)
        return (value >> (64 - 8 * count)).to_bytes(4 * self._words + count, "big")


class WideReader:
    """Reads decisions. Raises TruncatedError or SectionError on bytes that `WideWriter` cannot have written."""

    def __init__(self, data: bytes) -> None:
        self._data, self._read, self._window, self._range = data, 0, 0, WINDOW - 1
        self._next()
        self._next()
        self._code = self._window
        if self._code == WINDOW - 1:
            raise SectionError("a coded stream cannot begin with eight bytes of 255")

    def bit(self, _: int, probability: int) -> int:
        """Read one decision."""
        bound = (self._range >> 15) * probability
        bit = int(self._code < bound)
        if bit:
            self._range = bound
        else:
            self._code -= bound
            self._range -= bound
        if self._range < MOVE:
            self._code, self._range = self._code << 32 | self._next(), self._range << 32
        return bit

    def plain(self, _: int, bits: int) -> int:
        """Read equally likely bits."""
        self._range >>= bits
        value = self._code // self._range
        if value >> bits:
            raise SectionError("a coded stream has a value beyond its interval")
        self._code -= value * self._range
        if self._range < MOVE:
            self._code, self._range = self._code << 32 | self._next(), self._range << 32
        return value

    def finish(self) -> None:
        """Raises SectionError unless the stream ends here, in the bytes that the writer writes."""
        value, count = end_of((self._window - self._code) % WINDOW, self._range)
        if self._window != value % WINDOW or len(self._data) != self._read - 8 + count:
            raise SectionError("the end of a coded stream does not fit its decisions", len(self._data))

    def _next(self) -> int:
        if self._read >= len(self._data) + 8:
            raise TruncatedError("a coded stream ends too early", len(self._data))
        word = int.from_bytes(self._data[self._read : self._read + 4].ljust(4, b"\0"), "big")
        self._read += 4
        self._window = (self._window << 32 | word) % WINDOW
        return word

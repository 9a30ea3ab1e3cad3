"""Whole numbers in as few bytes as they need, for headers of sections: 7 bits a byte, the lowest first."""

from __future__ import annotations

from lidarcodec.errors import SectionError, TruncatedError


def put_varint(out: bytearray, value: int) -> None:
    """Append a whole number of up to 64 bits, 7 bits a byte, the lowest first."""
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)


def put_signed(out: bytearray, value: int) -> None:
    """Append a signed number of up to 63 bits."""
    put_varint(out, value << 1 if value >= 0 else (-value << 1) - 1)


class VarintReader:
    """Reads what `put_varint` and `put_signed` wrote; `offset` is the next byte."""

    def __init__(self, data: bytes) -> None:
        self._data, self.offset = data, 0

    def __len__(self) -> int:
        """Number of bytes that are left."""
        return len(self._data) - self.offset

    def byte(self) -> int:
        """Next byte. Raises TruncatedError."""
        if self.offset >= len(self._data):
            raise TruncatedError("side information ends too early", self.offset)
        self.offset += 1
        return self._data[self.offset - 1]

    def varint(self, limit: int, least: int = 0) -> int:
        """Next number. Raises SectionError if it is not from `least` to `limit`, or has more bytes than it needs."""
        start, value, shift = self.offset, 0, 0
        while True:
            byte = self.byte()
            value |= (byte & 0x7F) << shift
            shift += 7
            if value > limit or shift > 70:
                raise SectionError(f"side information: a number over {limit}", start)
            if byte < 0x80:
                if value < least or (byte == 0 and shift > 7):
                    raise SectionError(f"side information: a number below {least}, or longer than needed", start)
                return value

    def signed(self, limit: int) -> int:
        """Next signed number, from -limit to limit."""
        number = self.varint(2 * limit)
        return number >> 1 if number & 1 == 0 else -((number + 1) >> 1)

    def take(self, size: int) -> bytes:
        """Next `size` bytes. Raises TruncatedError."""
        if size > len(self._data) - self.offset:
            raise TruncatedError("side information ends too early", self.offset)
        self.offset += size
        return self._data[self.offset - size : self.offset]

    def rest(self, limit: int) -> bytes:
        """All that is left. Raises SectionError if that is more than `limit` bytes."""
        if len(self._data) - self.offset > limit:
            raise SectionError("bytes after the end of side information", self.offset + limit)
        return self.take(len(self._data) - self.offset)

    def end(self) -> None:
        """Raises SectionError if there are bytes left."""
        if self.offset != len(self._data):
            raise SectionError("bytes after the end of side information", self.offset)

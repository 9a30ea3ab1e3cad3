"""CRC-32C over a whole message: its last four bytes, little endian, over all bytes before them."""

from __future__ import annotations

from lidarcodec._native import crc32c
from lidarcodec.errors import ChecksumError
from lidarcodec.wire.header import CHECKSUM_BYTES


def with_checksum(body: bytes) -> bytes:
    """The bytes with their checksum appended."""
    return body + int(crc32c(body)).to_bytes(CHECKSUM_BYTES, "little")


def checked_body(data: bytes) -> bytes:
    """The bytes before the checksum.

    Raises ChecksumError if it does not match; the caller knows that there are four bytes at least.
    """
    body = data[:-CHECKSUM_BYTES]
    stored, computed = int.from_bytes(data[-CHECKSUM_BYTES:], "little"), int(crc32c(body))
    if stored != computed:
        raise ChecksumError(f"message checksum is {computed:08x}, it says {stored:08x}", len(body))
    return body


def checksum_of(data: bytes) -> int:
    """The checksum that a whole message says it has."""
    return int.from_bytes(data[-CHECKSUM_BYTES:], "little")

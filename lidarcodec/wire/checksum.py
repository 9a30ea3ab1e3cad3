"""CRC-32C of a message: its last four bytes, little endian, computed over all bytes before them."""

from __future__ import annotations

from lidarcodec._native import crc32c
from lidarcodec.errors import ChecksumError
from lidarcodec.wire.header import CHECKSUM_BYTES


def with_checksum(body: bytes) -> bytes:
    """The bytes with their checksum appended."""
    return body + int(crc32c(body)).to_bytes(CHECKSUM_BYTES, "little")


def checked_body(data: bytes) -> bytes:
    """The bytes before the checksum.

    data: at least four bytes. Raises ChecksumError if the checksum does not match.
    """
    body = data[:-CHECKSUM_BYTES]
    stored, computed = int.from_bytes(data[-CHECKSUM_BYTES:], "little"), int(crc32c(body))
    if stored != computed:
        raise ChecksumError(f"the message's checksum should be {computed:08x}, but is {stored:08x}", len(body))
    return body


def checksum_of(data: bytes) -> int:
    """The checksum stored in a message; it is not compared with the contents."""
    return int.from_bytes(data[-CHECKSUM_BYTES:], "little")

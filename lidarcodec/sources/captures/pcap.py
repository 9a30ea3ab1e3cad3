"""Records of a classic pcap file: a 24-byte header, then 16 bytes before each frame, in either byte order.

    magic a1b2c3d4: time stamps in microseconds      a1b23c4d: in nanoseconds      (reversed: the other byte order)

Format: draft-ietf-opsawg-pcap, sections 4 and 5. Lengths are checked before memory is taken. An invalid record ends the
reading, because the start of the next one is unknown.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import Final, NamedTuple

from lidarcodec.budgets import RECORDS_BASE, RECORDS_PER_BYTE, Allowance
from lidarcodec.sources.decompress import ByteStream

HEADER_BYTES: Final = 24
RECORD_BYTES: Final = 16
MAX_FRAME: Final = 262_144
"""Largest frame that capture programs write (tcpdump's largest snap length)."""
MAGICS: Final[dict[bytes, tuple[str, int]]] = {
    b"\xd4\xc3\xb2\xa1": ("<", 1000),
    b"\xa1\xb2\xc3\xd4": (">", 1000),
    b"\x4d\x3c\xb2\xa1": ("<", 1),
    b"\xa1\xb2\x3c\x4d": (">", 1),
}
"""First four bytes -> byte order and nanoseconds in a step of the sub-second field."""


CHECKED_EVERY: Final = 4096
"""Number of records between two checks of their number against the bytes read."""


class Record(NamedTuple):
    """One captured frame: host time in ns since the Unix epoch, link type, bytes."""

    stamp_ns: int
    linktype: int
    data: bytes


class Counted:
    """Limits records in proportion to the bytes read: a few compressed bytes can hold a million empty records."""

    def __init__(self, stream: ByteStream, ending: Ending) -> None:
        self._stream, self._ending = stream, ending
        self._allowed = Allowance(RECORDS_BASE, RECORDS_PER_BYTE)

    def too_many(self, number: int) -> bool:
        """Whether there are too many records, so that reading ends. Called for every record with its number."""
        if number % CHECKED_EVERY or self._allowed.spend(CHECKED_EVERY, self._stream.taken):
            return False
        self._ending.set("damaged", f"more than {number:,} records in {self._stream.taken:,} bytes, as no capture has")
        return True


class Ending:
    """Why reading a capture ended early: `cause` is a key of the source's counts, `text` a sentence. None: no error."""

    def __init__(self) -> None:
        self.cause: str | None = None
        self.text = ""

    def set(self, cause: str, text: str) -> None:
        """Note an error, if it is the first."""
        if self.cause is None:
            self.cause, self.text = cause, text

    def replace(self, cause: str, text: str) -> None:
        """Replace the noted error by its cause: a record is cut because the compressed data is."""
        self.cause, self.text = cause, text


def read_pcap(stream: ByteStream, data: bytes, ending: Ending) -> Iterator[Record]:
    """Records of a stream whose first bytes `data` were read already: at least four, which are in MAGICS.

    Never raises for what it reads: `ending` says if the file was cut or damaged. Cost: about 0.7 us a record.
    """
    order, step_ns = MAGICS[data[:4]]
    while len(data) < HEADER_BYTES:
        more = stream.read(HEADER_BYTES)
        if not more:
            ending.set("truncated", "it ends within the file header")
            return
        data += more
    linktype = struct.unpack_from(order + "I", data, 20)[0] & 0x03FF_FFFF  # the bits above: length of a checksum
    unpack = struct.Struct(order + "IIII").unpack_from
    start, size, number = HEADER_BYTES, len(data), 0
    too_many = Counted(stream, ending).too_many
    while True:
        body = start + RECORD_BYTES
        end = body
        if body <= size:
            seconds, fraction, captured, original = unpack(data, start)
            if not (seconds or captured or original):  # zeros: the end of this file was never written to the disk
                ending.set("damaged", f"record {number} and what follows are zeros")
                return
            if captured > MAX_FRAME:
                ending.set("damaged", f"record {number} claims {captured} bytes (limit {MAX_FRAME})")
                return
            end = body + captured
        if body > size or end > size:
            more = stream.read(end - size)
            if not more:
                if start < size:
                    ending.set("truncated", f"record {number} has {size - start} of its bytes")
                return
            data, start = data[start:] + more, 0
            size = len(data)
            continue
        yield Record(seconds * 1_000_000_000 + fraction * step_ns, linktype, data[body:end])
        start = end
        number += 1
        if not number % CHECKED_EVERY and too_many(number):
            return

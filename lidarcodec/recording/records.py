"""MCAP records of a file. Records are read one at a time, and every length is checked.

The readers of the `mcap` package fail on a cut file, or read the whole file first (docs/decisions/0002). This reader
stops at the first incomplete record. Layouts: mcap.dev/spec.
"""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Iterator
from typing import IO, Final, NamedTuple

import lz4.frame
import zstandard

from lidarcodec.budgets import EXPANDED_BASE, EXPANDED_TIMES, MIB, RECORDS_BASE, RECORDS_PER_BYTE, Allowance
from lidarcodec.errors import SourceError

MAGIC: Final = b"\x89MCAP0\r\n"
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK = 1, 2, 3, 4, 5, 6
CHUNK_INDEX, STATISTICS, METADATA, DATA_END = 8, 11, 12, 15
MAX_RECORD: Final = 65 * 2**20
"""Largest record that is read into memory: a message of 64 MiB and the overhead of MCAP."""

MAX_CHUNK_RECORDS: Final = 1 << 19
"""Most records of a chunk, because a chunk is held in memory. Programs write chunks of 1 to 4 MB."""
MAX_NAME: Final = 4096
"""Longest name of a topic, an encoding or a type, in bytes."""
MAX_ABOUT: Final = MIB
"""Largest metadata text, in bytes."""
_WINDOW: Final = 128 * MIB

_HEAD: Final = struct.Struct("<BQ")
_MESSAGE: Final = struct.Struct("<HIQQ")
_CHUNK: Final = struct.Struct("<QQQII")
_CHUNK_INDEX: Final = struct.Struct("<QQQQ")
_FOOTER: Final = struct.Struct("<QQI")


class DamagedError(Exception):
    """A record contradicts itself. This package never raises it to callers."""


class Record(NamedTuple):
    """A record: opcode, offset and length of its content in bytes, and whether it is complete."""

    opcode: int
    start: int
    length: int
    whole: bool

    @property
    def offset(self) -> int:
        """Offset of the record."""
        return self.start - _HEAD.size

    @property
    def end(self) -> int:
        """Offset of the next record."""
        return self.start + self.length


class Stored(NamedTuple):
    """A stored message: channel, log time, offset and length of its data, and sequence number."""

    channel: int
    log_time: int
    source: IO[bytes]
    start: int
    length: int
    sequence: int = 0

    def data(self, limit: int = MAX_RECORD) -> bytes:
        """The data, at most `limit` bytes of it.

        Raises SourceError if the file has become shorter since the message was found.
        """
        try:
            return read(self.source, self.start, min(self.length, limit))
        except DamagedError:
            name = getattr(self.source, "name", "the file")
            text = f"{name} became shorter while it was read: try again when no program changes it"
            raise SourceError(text) from None


class Chunk(NamedTuple):
    """Head of a chunk: times of its first and last message, and offset of its records."""

    first_time: int
    last_time: int
    plain_bytes: int
    crc: int
    compression: str
    start: int
    length: int


class Channel(NamedTuple):
    """A channel: id, topic, encoding of its messages, and the id of their schema (0: none)."""

    number: int
    topic: str
    encoding: str
    schema: int = 0


class Work:
    """Limits the expanded bytes and the records of chunks in proportion to the bytes read so far.

    A compressed chunk of 2 kB may expand to 65 MiB, or to seven million empty records.
    """

    def __init__(self) -> None:
        self._expanded = Allowance(EXPANDED_BASE, EXPANDED_TIMES)
        self._records = Allowance(RECORDS_BASE, RECORDS_PER_BYTE)

    def open(self, chunk: Chunk) -> None:
        """Call this before a chunk is opened. Raises DamagedError if chunks expand to too much."""
        if chunk.compression and not self._expanded.spend(chunk.plain_bytes, chunk.start + chunk.length):
            raise DamagedError(f"chunks expand to more than {EXPANDED_TIMES} times their size")

    def count(self, found: Iterator[Record], chunk: Chunk) -> Iterator[Record]:
        """The records of a chunk. Raises DamagedError if there are too many."""
        for number, record in enumerate(found):
            if number == MAX_CHUNK_RECORDS:
                raise DamagedError(f"a chunk has more than {MAX_CHUNK_RECORDS} records")
            if not self._records.spend(1, chunk.start + chunk.length):
                raise DamagedError("too many records for the size of the file")
            yield record


def read(stream: IO[bytes], start: int, length: int) -> bytes:
    """Read exactly `length` bytes.

    Raises DamagedError if the file ends before.
    """
    if length > MAX_RECORD:
        raise DamagedError(f"a record of {length} bytes is too large")
    stream.seek(start)
    data = stream.read(length)
    if len(data) != length:
        raise DamagedError(f"{length} bytes are needed at {start}, but only {len(data)} are left")
    return data


def size_of(stream: IO[bytes]) -> int:
    """Bytes of a file."""
    return stream.seek(0, io.SEEK_END)


def records(stream: IO[bytes], start: int, end: int) -> Iterator[Record]:
    """Records between two offsets. The last one may be incomplete; a rest shorter than a record's head is ignored.

    Ends at opcode 0. No record has it, but a file can end with zeros after a power failure.
    """
    while end - start >= _HEAD.size:
        opcode, length = _HEAD.unpack(read(stream, start, _HEAD.size))
        if opcode == 0:
            return
        record = Record(opcode, start + _HEAD.size, length, start + _HEAD.size + length <= end)
        yield record
        if not record.whole:
            return
        start = record.end


def _text(data: bytes, at: int, most: int = MAX_ABOUT) -> tuple[str, int]:
    if at + 4 > len(data):
        raise DamagedError("a text ends beyond its record")
    end = at + 4 + int.from_bytes(data[at : at + 4], "little")
    if end > len(data) or end - at - 4 > most:
        raise DamagedError(f"a text ends beyond its record, or has more than {most} bytes")
    try:
        return data[at + 4 : end].decode(), end
    except UnicodeDecodeError:
        raise DamagedError("a text is not UTF-8") from None


def channel_of(stream: IO[bytes], record: Record) -> Channel:
    """The channel in a record."""
    data = read(stream, record.start, min(record.length, 4 * MAX_NAME))
    name, at = _text(data, 4, MAX_NAME)
    encoding, _ = _text(data, at, MAX_NAME)
    return Channel(int.from_bytes(data[:2], "little"), name, encoding, int.from_bytes(data[2:4], "little"))


def schema_of(stream: IO[bytes], record: Record) -> tuple[int, str]:
    """Id and name of the schema in a record."""
    data = read(stream, record.start, min(record.length, 2 * MAX_NAME))
    name, _ = _text(data, 2, MAX_NAME)
    return int.from_bytes(data[:2], "little"), name


def profile_of(stream: IO[bytes], start: int, end: int) -> str:
    """The profile in the file's header, such as `ros2`; empty if there is none."""
    for record in records(stream, start, end):
        if record.opcode == HEADER and record.whole:
            return _text(read(stream, record.start, record.length), 0)[0]
        break
    return ""


def metadata_of(stream: IO[bytes], record: Record) -> tuple[str, dict[str, str]]:
    """Name and texts of a metadata record."""
    data = read(stream, record.start, record.length)
    name, at = _text(data, 0)
    at, end = at + 4, at + 4 + int.from_bytes(data[at : at + 4], "little")
    texts: dict[str, str] = {}
    while at < end:
        key, at = _text(data, at)
        texts[key], at = _text(data, at)
    return name, texts


def stored_of(stream: IO[bytes], record: Record) -> Stored:
    """The message of a record; its data is not read yet."""
    if record.length < _MESSAGE.size:
        raise DamagedError(f"a message record has only {record.length} bytes")
    channel, sequence, log_time, _ = _MESSAGE.unpack(read(stream, record.start, _MESSAGE.size))
    return Stored(channel, log_time, stream, record.start + _MESSAGE.size, record.length - _MESSAGE.size, sequence)


def chunk_of(stream: IO[bytes], record: Record) -> Chunk:
    """Head of a chunk, which may be incomplete."""
    first, last, plain, crc, name_bytes = _CHUNK.unpack(read(stream, record.start, _CHUNK.size))
    if name_bytes > 32:
        raise DamagedError("the name of a compression has more than 32 bytes")
    at = record.start + _CHUNK.size
    tail = read(stream, at, name_bytes + 8)
    start = at + name_bytes + 8
    length = int.from_bytes(tail[name_bytes:], "little")
    if start + length != record.end:
        raise DamagedError(f"a chunk has {record.length} bytes, but its records {length}")
    return Chunk(first, last, plain, crc, tail[:name_bytes].decode("ascii", "replace"), start, length)


def opened(stream: IO[bytes], chunk: Chunk, end: int, check: bool = True) -> tuple[IO[bytes], int, int]:
    """The records of a chunk: file, first offset, last offset.

    end: end of the file, which may cut the chunk; check: whether to check the checksum of uncompressed records
    Raises DamagedError if they cannot be read.
    """
    if not chunk.compression:
        last = min(chunk.start + chunk.length, end)
        whole = last == chunk.start + chunk.length and chunk.length <= MAX_RECORD
        if check and whole and chunk.crc and zlib.crc32(read(stream, chunk.start, chunk.length)) != chunk.crc:
            raise DamagedError(f"the checksum of the chunk at {chunk.start} is wrong")
        return stream, chunk.start, last
    if chunk.plain_bytes > MAX_RECORD:
        raise DamagedError(f"a chunk of {chunk.plain_bytes} bytes is too large")
    packed = read(stream, chunk.start, chunk.length)
    try:
        if chunk.compression == "zstd":
            plain = (
                zstandard.ZstdDecompressor(max_window_size=_WINDOW).stream_reader(packed).read(chunk.plain_bytes + 1)
            )
        elif chunk.compression == "lz4":
            plain = lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=chunk.plain_bytes + 1)
        else:
            raise DamagedError(f"a chunk has the unknown compression '{chunk.compression}'")
    except (zstandard.ZstdError, RuntimeError, EOFError) as error:
        raise DamagedError(f"a chunk is damaged: {error}") from None
    if len(plain) != chunk.plain_bytes or (chunk.crc and zlib.crc32(plain) != chunk.crc):
        raise DamagedError("a chunk does not match its size or checksum")
    return io.BytesIO(plain), 0, len(plain)


def summary_start(stream: IO[bytes], size: int) -> int | None:
    """Offset of the summary, None if the file has none or was cut."""
    if size < len(MAGIC) * 2 + _HEAD.size + _FOOTER.size:
        return None
    tail = read(stream, size - len(MAGIC) - _FOOTER.size - _HEAD.size, _HEAD.size + _FOOTER.size + len(MAGIC))
    opcode, length = _HEAD.unpack_from(tail)
    start, _, _ = _FOOTER.unpack_from(tail, _HEAD.size)
    if not tail.endswith(MAGIC) or opcode != FOOTER or length != _FOOTER.size or not 0 < start < size:
        return None
    return int(start)


def message_count(stream: IO[bytes], record: Record) -> int:
    """Number of messages by the file's statistics."""
    return int.from_bytes(read(stream, record.start, 8), "little")


def chunk_span(stream: IO[bytes], record: Record) -> tuple[int, int, int]:
    """Times of the first and the last message, and offset of the chunk in an index record."""
    if record.length < _CHUNK_INDEX.size:
        raise DamagedError(f"a chunk index has only {record.length} bytes")
    first, last, start, _ = _CHUNK_INDEX.unpack(read(stream, record.start, _CHUNK_INDEX.size))
    return first, last, start

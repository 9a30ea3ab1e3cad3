"""Messages of a bag of ROS 1 (.bag, format 2.0). The file is not trusted.

    "#ROSBAG V2.0\\n", then records: length u32 and a head of fields (length u32, name=value), length u32 and data
    op 3 head of the bag, 5 chunk (compression, size; its data are records), 7 connection (conn, topic; its data are
    fields: type, ...), 2 message (conn, time), 4 and 6 indexes, which are not read

A cut bag, or one that was not closed, gives every message before its end. Source: wiki.ros.org/Bags/Format/2.0.
"""

from __future__ import annotations

import bz2
import logging
import struct
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any, Final, NamedTuple

from lidarcodec.budgets import EXPANDED_BASE, EXPANDED_TIMES, RECORDS_BASE, RECORDS_PER_BYTE, Allowance
from lidarcodec.errors import SourceError
from lidarcodec.files.regular import open_regular
from lidarcodec.recording.records import MAX_RECORD
from lidarcodec.sources.magic import BAG_MAGIC

logger = logging.getLogger(__name__)

MAX_HEAD: Final = 1 << 16
MAX_CONNECTIONS: Final = 4096
_MESSAGE, _CHUNK, _CONNECTION = b"\2", b"\5", b"\7"
_LENGTH: Final = struct.Struct("<I")


class _Record(NamedTuple):
    head: dict[bytes, bytes]
    data: bytes


class _DamagedError(Exception):
    """The file ends within a record, or a record is none."""


def is_bag(path: Path) -> bool:
    """Whether a file is a bag of ROS 1. Raises OSError."""
    with open_regular(path) as file:
        return file.read(len(BAG_MAGIC)) == BAG_MAGIC


def topics(path: Path) -> dict[str, str]:
    """Topic to type, as ROS 1 writes it (`sensor_msgs/PointCloud2`). Raises OSError."""
    found: dict[str, str] = {}
    with open_regular(path) as file:
        for record in _records(file, path, Counter(), warn=False):
            if record.head.get(b"op") == _CONNECTION and len(found) < MAX_CONNECTIONS:
                found[_text(record.head.get(b"topic", b""))] = _type_of(record)
    return found


def _type_of(connection: _Record) -> str:
    try:
        return _text(_fields(connection.data).get(b"type", b""))
    except _DamagedError:
        return ""


def messages(path: Path, topic: str, counts: Counter[str], warn: bool = True) -> Iterator[bytes]:
    """Messages of a topic in the order of the file. Damage ends the reading; it is counted and logged."""
    wanted: set[bytes] = set()
    try:
        with open_regular(path) as file:
            for record in _records(file, path, counts, warn):
                kind, conn = record.head.get(b"op"), record.head.get(b"conn", b"")
                if kind == _CONNECTION and _text(record.head.get(b"topic", b"")) == topic:
                    if len(wanted) < MAX_CONNECTIONS:
                        wanted.add(conn)
                elif kind == _MESSAGE and conn in wanted:
                    yield record.data
    except OSError as error:
        raise SourceError(f"cannot read {path}: {error.strerror or error}") from None


def _records(file: IO[bytes], path: Path, counts: Counter[str], warn: bool) -> Iterator[_Record]:
    """Records of connections and messages, those in chunks too."""
    file.seek(len(BAG_MAGIC))
    expands, read = Allowance(EXPANDED_BASE, EXPANDED_TIMES), 0
    allowed = Allowance(RECORDS_BASE, RECORDS_PER_BYTE)
    try:
        while (record := _read(file)) is not None:
            _count(allowed, file.tell())
            if record.head.get(b"op") != _CHUNK:
                yield record
                continue
            read += len(record.data)
            for inner in _inside(_plain(record, expands, read)):
                _count(allowed, file.tell())
                yield inner
    except _DamagedError as error:
        counts["damaged"] += 1
        if warn:
            logger.warning("%s is damaged: %s. The rest was not read", path, error)


def _count(allowed: Allowance, seen: int) -> None:
    if not allowed.spend(1, seen):
        raise _DamagedError("it has more records than a file of its size")


def _read(file: IO[bytes]) -> _Record | None:
    """The next record; None at the end of the file."""
    raw = file.read(_LENGTH.size)
    if not raw:
        return None
    head = _bytes(file, _length(raw, MAX_HEAD))
    return _Record(_fields(head), _bytes(file, _length(file.read(_LENGTH.size), MAX_RECORD)))


def _length(raw: bytes, most: int) -> int:
    if len(raw) < _LENGTH.size:
        raise _DamagedError("it is cut off")
    length = int(_LENGTH.unpack(raw)[0])
    if length > most:
        raise _DamagedError(f"a record has {length} bytes: the limit is {most}")
    return length


def _bytes(file: IO[bytes], size: int) -> bytes:
    found = file.read(size)
    if len(found) < size:
        raise _DamagedError("it is cut off")
    return found


def _inside(plain: bytes) -> Iterator[_Record]:
    """Records of a chunk."""
    at = 0
    while at < len(plain):
        parts = []
        for most in (MAX_HEAD, MAX_RECORD):
            length = _length(plain[at : at + _LENGTH.size], most)
            at += _LENGTH.size
            parts.append(plain[at : at + length])
            at += length
        if at > len(plain):
            raise _DamagedError("a chunk is cut off")
        yield _Record(_fields(parts[0]), parts[1])


def _plain(chunk: _Record, expands: Allowance, read: int) -> bytes:
    """The records of a chunk. expands: limit of what all chunks become; read: bytes of all of them so far"""
    raw = chunk.head.get(b"size", b"")
    size = _length(raw, MAX_RECORD)
    if not expands.spend(size, read):
        raise _DamagedError(f"its chunks expand to more than {EXPANDED_TIMES} times their size")
    how = chunk.head.get(b"compression", b"none")
    if how == b"none":
        return chunk.data
    try:
        decompressor: Any
        if how == b"bz2":
            decompressor = bz2.BZ2Decompressor()
        elif how == b"lz4":
            import lz4.frame

            decompressor = lz4.frame.LZ4FrameDecompressor()
        else:
            raise _DamagedError(f"a chunk has the unknown compression '{_text(how)[:20]}'")
        plain: bytes = decompressor.decompress(chunk.data, max_length=size) if size else b""
    except (OSError, EOFError, ValueError, RuntimeError) as error:
        raise _DamagedError(f"a chunk cannot be decompressed: {error}") from None
    if len(plain) != size:
        raise _DamagedError(f"a chunk has {len(plain)} bytes, but announces {size}")
    return plain


def _fields(head: bytes) -> dict[bytes, bytes]:
    found: dict[bytes, bytes] = {}
    at = 0
    while at + _LENGTH.size <= len(head):
        (length,) = _LENGTH.unpack_from(head, at)
        name, sign, value = head[at + _LENGTH.size : at + _LENGTH.size + length].partition(b"=")
        if not sign or at + _LENGTH.size + length > len(head):
            raise _DamagedError("the header of a record is damaged")
        found[name] = value
        at += _LENGTH.size + length
    return found


def _text(data: bytes) -> str:
    return data.decode("utf-8", "backslashreplace")[:1024]

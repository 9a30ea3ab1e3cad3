"""Records of classic captures, unchanged and with any content, and the calibration beside a capture."""

from __future__ import annotations

import logging
import struct
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO, Final, NamedTuple

from lidarcodec.budgets import FileTooLargeError, read_file
from lidarcodec.errors import CalibrationError, LidarCodecError, SourceError
from lidarcodec.sensors.calibration_kinds import kind_in
from lidarcodec.sources import open_source
from lidarcodec.sources.described import DB_XML

logger = logging.getLogger(__name__)

HEADER_BYTES: Final = 24
ORDERS: Final = {
    b"\xd4\xc3\xb2\xa1": "<",
    b"\x4d\x3c\xb2\xa1": "<",
    b"\xa1\xb2\xc3\xd4": ">",
    b"\xa1\xb2\x3c\x4d": ">",
}
"""Magic numbers of classic pcap files, with microseconds and with nanoseconds, and their byte order."""
NANOSECONDS: Final = (b"\x4d\x3c\xb2\xa1", b"\xa1\xb2\x3c\x4d")
"""Those whose fractions of seconds are nanoseconds."""
CALIBRATION: Final = DB_XML
ENDINGS: Final = (CALIBRATION, ".yaml", ".csv", ".json")
"""Of calibrations, and of an Ouster's metadata, beside a capture."""
_MAX_RECORD: Final = 1 << 18


class Record(NamedTuple):
    """A packet of a capture. stamp: seconds and fraction;  data: its bytes in the file, with the record header"""

    stamp: tuple[int, int]
    data: bytes


def opened(handle: BinaryIO, path: Path) -> bytes:
    """The header of a classic capture.

    Raises SourceError if it is another file.
    """
    found = handle.read(HEADER_BYTES)
    if found[:4] not in ORDERS or len(found) != HEADER_BYTES:
        raise SourceError(f"{path} is not a classic .pcap file: convert it first with `lidarcodec convert`")
    return found


def records(handle: BinaryIO, path: Path, order: str, skip_damage: bool) -> Iterator[Record]:
    """Complete records of a file, after its header."""
    number = 0
    while head := handle.read(16):
        record = _record(handle, head, order)
        if not isinstance(record, Record):
            what, why = record
            damage = f"{path} is {what}: record {number} {why}"
            if not skip_damage:
                raise SourceError(f"{damage}. Use --allow-gap to take the packets before that place")
            logger.warning("%s. Only the packets before that place were read", damage)
            return
        yield record
        number += 1


def _record(handle: BinaryIO, head: bytes, order: str) -> Record | tuple[str, str]:
    """The record with this header. Else what the file is, and why, in the words in which a CaptureSource says it."""
    if len(head) < 16:
        return "truncated", f"has {len(head)} of its bytes"
    seconds, fraction, length, original = struct.unpack(f"{order}IIII", head)
    if not (seconds or length or original):  # as after a power failure
        return "damaged", "and what follows are zeros"
    if length > _MAX_RECORD:
        return "damaged", f"claims {length} bytes (limit {_MAX_RECORD})"
    data = handle.read(length)
    if len(data) < length:
        return "truncated", f"has {16 + len(data)} of its bytes"
    return Record((seconds, fraction), head + data)


def read_table(path: Path) -> bytes:
    """The bytes of a calibration. Raises CalibrationError if it is too large."""
    try:
        return read_file(path, "calibration")
    except FileTooLargeError as error:
        raise CalibrationError(f"{path}: {error}") from None


def named_beside(path: Path, ending: str) -> Path:
    """Path of a file beside a capture, of the same name but for its ending."""
    return path.with_name(path.stem + ending)


def tables_of(path: Path) -> dict[str, bytes]:
    """Calibration and metadata beside a capture, by the ending of a file that is found beside a copy of it: of the
    same name, or what is used for want of such a one.

    Raises CalibrationError for one that is too large.
    """
    found: dict[str, bytes] = {}
    for ending in ENDINGS:
        place = named_beside(path, ending)
        if place == path or not place.is_file():
            continue
        if ending == CALIBRATION:
            found[ending] = read_table(place)
            continue
        with suppress(OSError, FileTooLargeError):  # a .csv may be points
            data = read_file(place, "calibration")
            if kind_in(data) is not None:
                found[ending] = data
    return found or _used_of(path)


def _used_of(path: Path) -> dict[str, bytes]:
    """The calibration of another name in the folder of a capture, which its parts elsewhere would lack."""
    if path.with_name("db.xml").is_file():
        return {CALIBRATION: read_table(path.with_name("db.xml"))}
    if not any(one.suffix.lower() == ".json" for one in path.parent.iterdir()):
        return {}
    with suppress(LidarCodecError), open_source(path) as source:
        if source.sensor.origin == "beside" and source.sensor.description:
            return {".json": source.sensor.description}
    return {}


def said_beside(path: Path) -> str:
    """What a file of `tables_of` is, and where, for people."""
    return f"{'metadata' if path.suffix == '.json' else 'calibration'} in {path}"

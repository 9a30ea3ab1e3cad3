"""Joins captures: copies every record unchanged, with any content."""

from __future__ import annotations

import logging
import struct
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import BinaryIO, Final, NamedTuple

from lidarcodec.budgets import FileTooLargeError, read_file
from lidarcodec.commands.progress import progress
from lidarcodec.commands.running.stopping import StoppedError, Watched, stoppable
from lidarcodec.commands.running.telling import tell
from lidarcodec.errors import CalibrationError, SettingsError, SourceError
from lidarcodec.files.regular import open_regular
from lidarcodec.files.whole import check_free, whole

log = logging.getLogger(__name__)

_HEADER_BYTES: Final = 24
_ORDERS: Final = {
    b"\xd4\xc3\xb2\xa1": "<",
    b"\x4d\x3c\xb2\xa1": "<",
    b"\xa1\xb2\xc3\xd4": ">",
    b"\xa1\xb2\x3c\x4d": ">",
}
"""Magic numbers of classic pcap files, with microseconds and with nanoseconds, and their byte order."""
_MAX_RECORD: Final = 1 << 18


class Record(NamedTuple):
    """A packet of a capture. stamp: seconds and fraction;  data: its bytes in the file, with the record header"""

    stamp: tuple[int, int]
    data: bytes


def run(paths: Sequence[Path], out: Path, allow_gap: bool, force: bool, as_json: bool = False) -> None:
    """Copy the parts, and the calibration next to them.

    Raises SourceError for a damaged part. If gaps are allowed, its complete packets are copied instead.
    """
    table = _calibration(paths)
    if table is not None and not _to_be_written(_calibration_of(out), table, force):
        table = None
    count = 0
    with (
        stoppable() as stopped,
        whole(out, force=force) as output,
        progress("joining") as tick,
        output.beside.open("wb") as to,
    ):
        header = b""
        last = (0, 0)
        for path in paths:
            with open_regular(path) as handle:
                found = handle.read(_HEADER_BYTES)
                if found[:4] not in _ORDERS or len(found) != _HEADER_BYTES:
                    raise SourceError(f"{path} is not a classic pcap file: convert it first with `lidarcodec convert`")
                if header and found != header:
                    raise SettingsError(
                        f"{path} has another pcap format than {paths[0]}: convert both first with `lidarcodec convert`"
                    )
                if not header:
                    header = found
                    to.write(header)
                watched = Watched(_records(handle, path, _ORDERS[header[:4]], allow_gap), stopped)
                for number, record in enumerate(watched):
                    if number == 0 and record.stamp < last:
                        raise SettingsError(
                            f"{path} begins before the previous part ends: give the parts in order, and without overlap"
                        )
                    last = max(last, record.stamp)
                    to.write(record.data)
                    count += 1
                tick()
                if watched.cut:
                    raise StoppedError(f"stopped: {out} was not written, and the parts were not changed")
        beside = table is not None and not output.straight
        if table is not None and beside:
            output.companion(_calibration_of, ".xml").write_bytes(table)
    tables = [str(_calibration_of(output.kept))] if beside and output.kept is not None else []
    tell(
        {"output": str(output.kept), "beside": tables, "parts": len(paths), "messages": None, "packets": count},
        f"{output.kept}: {count} packets of {len(paths)} parts" + "".join(f"; calibration in {one}" for one in tables),
        as_json,
    )


def _records(handle: BinaryIO, path: Path, order: str, allow_gap: bool) -> Iterator[Record]:
    """Complete records of a file, after its header."""
    number = 0
    while (head := handle.read(16)) and (record := _record(handle, head, order)) is not None:
        yield record
        number += 1
    if head:
        damage = f"{path} is damaged: packet {number} and the rest are incomplete"
        if not allow_gap:
            raise SourceError(f"{damage}; use --allow-gap to join the other packets")
        log.warning("%s and were skipped", damage)


def _record(handle: BinaryIO, head: bytes, order: str) -> Record | None:
    """The record with this header. None if it is cut off, or all zeros, as after a power failure."""
    if len(head) < 16:
        return None
    seconds, fraction, length, original = struct.unpack(f"{order}IIII", head)
    if length > _MAX_RECORD or not (seconds or length or original):
        return None
    data = handle.read(length)
    return Record((seconds, fraction), head + data) if len(data) == length else None


def _calibration(paths: Sequence[Path]) -> bytes | None:
    """The calibration next to the parts; None if there is none.

    Raises SettingsError if there are different ones, CalibrationError if one is too large.
    """
    found = [(path, _read(_calibration_of(path))) for path in paths if _calibration_of(path).is_file()]
    for path, table in found:
        if table != found[0][1]:
            raise SettingsError(
                f"the calibrations next to {path} and {found[0][0]} differ: the captures come from two sensors"
            )
    return found[0][1] if found else None


def _to_be_written(path: Path, table: bytes, force: bool) -> bool:
    """Whether the calibration must be written. Raises SettingsError if there is already another one."""
    if path.is_file() and not path.is_symlink() and path.stat().st_size == len(table) and path.read_bytes() == table:
        return False
    check_free(path, force=force)
    return True


def _read(path: Path) -> bytes:
    try:
        return read_file(path, "calibration")
    except FileTooLargeError as error:
        raise CalibrationError(f"{path}: {error}") from None


def _calibration_of(path: Path) -> Path:
    return path.with_name(f"{path.stem}_db.xml")

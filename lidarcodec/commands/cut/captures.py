"""Cuts captures: copies the records of a span of time unchanged, and the calibration beside them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import BinaryIO, NamedTuple

from lidarcodec.commands.capture_records import NANOSECONDS, ORDERS, named_beside, opened, records, tables_of
from lidarcodec.commands.cut.parts import Cut, say, write
from lidarcodec.errors import LidarCodecError
from lidarcodec.files.regular import open_regular
from lidarcodec.files.whole import Whole, check_free
from lidarcodec.sensors import STATUS_PACKETS
from lidarcodec.sources import open_source
from lidarcodec.sources.described import description_of
from lidarcodec.units import PACKET_BYTES


class _Timed(NamedTuple):
    stamp_ns: int
    data: bytes


def run(wanted: Cut) -> None:
    """Copy the records, into one capture or into parts. A damaged end is left out, with a warning."""
    found = tables_of(wanted.source)
    sent = {} if found else _sent_table(wanted.source)
    tables: list[Path] = []
    with open_regular(wanted.source) as handle:
        header = opened(handle, wanted.source)

        def write_beside(output: Whole, those: dict[str, bytes]) -> None:
            for ending, table in those.items() if not output.straight else ():
                name_of = partial(named_beside, ending=ending)
                check_free(name_of(output.path), force=wanted.force)
                output.companion(name_of, Path(ending).suffix or ending).write_bytes(table)
                tables.append(name_of(output.path))

        def write_part(output: Whole, to: BinaryIO, part: Iterable[_Timed]) -> int:
            write_beside(output, found)
            to.write(header)
            count = packets = 0
            for record in part:
                to.write(record.data)
                count += 1
                packets += len(record.data) > PACKET_BYTES
            if packets < STATUS_PACKETS:
                write_beside(output, sent)
            return count

        items = _numbered(wanted, _timed(handle, wanted.source, header))
        written, count = write(wanted, items, write_part)
    say(wanted, written, tables, count, "packets", 0)


def _sent_table(path: Path) -> dict[str, bytes]:
    """The table that an HDL-64E sends in its packets, as a file beside a capture; empty if this one does not have all
    of it. A part of fewer than STATUS_PACKETS packets would lack some."""
    try:
        with open_source(path, points=False) as source:
            beside = description_of(source.sensor) if source.sensor.origin == "stream" else None
    except LidarCodecError:  # other traffic can be cut, too
        return {}
    return {} if beside is None else dict([beside])


def _timed(handle: BinaryIO, path: Path, header: bytes) -> Iterator[_Timed]:
    fraction_ns = 1 if header[:4] in NANOSECONDS else 1000
    for (seconds, fraction), data in records(handle, path, ORDERS[header[:4]], True):
        yield _Timed(seconds * 10**9 + fraction * fraction_ns, data)


def _numbered(wanted: Cut, timed: Iterator[_Timed]) -> Iterator[tuple[int, _Timed]]:
    """Each record with the number of its part. A record with an earlier time than one before it stays in its part."""
    first_ns: int | None = None
    number = 0
    for record in wanted.selection.in_time(timed, whole=True):
        first_ns = record.stamp_ns if first_ns is None else first_ns
        if wanted.every_ns is not None:
            number = max(number, (record.stamp_ns - first_ns) // wanted.every_ns)
        yield number, record

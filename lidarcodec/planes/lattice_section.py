"""The LATTICE section: the columns that are sent of a thinned frame, and the side information of the whole one.

The format is docs/wire-format-sections.md, section "Lattice".

>>> from lidarcodec.lattice import columns_of
>>> read_lattice(lattice_bytes(Lattice(12, columns_of(12, 4, 2)))).columns.tolist()
[0, 2, 6, 10, 11]
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import replace
from typing import Final

import numpy as np

from lidarcodec import entropy
from lidarcodec.errors import SectionError, TruncatedError
from lidarcodec.lattice import Columns, Lattice, columns_of
from lidarcodec.side import SideInfo
from lidarcodec.units import MAX_COLUMNS, MAX_PACKETS

_REGULAR, _LISTED = 0, 1
_HEAD: Final = struct.Struct("<BHHHI")
_STEP: Final = struct.Struct("<HH")


def lattice_bytes(lattice: Lattice) -> bytes:
    """The LATTICE section: docs/wire-format-sections.md, "lattice"."""
    kind, columns = _columns_bytes(lattice)
    side = positions = b""
    packets = 0
    if lattice.side is not None:
        packets, side = lattice.side.packets, entropy.encode_side(lattice.side)
        positions = entropy.encode_positions(lattice.side.positions) if lattice.side.positions else b""
    head = _HEAD.pack(kind, lattice.width, packets, len(columns), len(side))
    return head + columns + side + positions


def read_lattice(data: bytes) -> Lattice:
    """The lattice that a LATTICE section holds.

    Raises SectionError or TruncatedError for one that is damaged.
    """
    if len(data) < _HEAD.size:
        raise TruncatedError(f"a lattice section of {len(data)} bytes")
    kind, width, packets, listed, size = _HEAD.unpack_from(data)
    if width > MAX_COLUMNS or packets > MAX_PACKETS:
        raise SectionError(
            f"a lattice of {width} columns and {packets} packets: at most {MAX_COLUMNS} and {MAX_PACKETS}"
        )
    behind = _HEAD.size + listed
    if behind + size > len(data):
        raise TruncatedError(f"a lattice section of {len(data)} bytes that announces {behind + size}")
    columns = _read_columns(kind, width, data[_HEAD.size : behind])
    if width and not len(columns):
        raise SectionError(f"a lattice without columns for a frame of {width} columns")
    side, positions = data[behind : behind + size], data[behind + size :]
    if not size:
        if packets or positions:
            raise SectionError(f"a lattice of {packets} packets without side information")
        return Lattice(width, columns)
    return Lattice(width, columns, _read_side(side, positions, width, packets))


def _read_side(side: bytes, positions: bytes, width: int, packets: int) -> SideInfo:
    known = entropy.decode_side(side, packets)
    if known.columns != width:
        raise SectionError(f"side information of {known.columns} columns in a lattice of {width}")
    return replace(known, positions=entropy.decode_positions(positions, packets)) if positions else known


def inflated(data: bytes, most: int) -> bytes | None:
    """The bytes of one zlib stream, `most` at most. None if it is damaged, holds more, or is followed by others."""
    inflate = zlib.decompressobj()
    try:
        plain = inflate.decompress(data, most + 1)
    except zlib.error:
        return None
    return plain if inflate.eof and not inflate.unused_data and len(plain) <= most else None


def _columns_bytes(lattice: Lattice) -> tuple[int, bytes]:
    width, columns = lattice.width, lattice.columns
    if len(columns) > 3:
        gap = int(columns[2]) - int(columns[1])
        for phase in {int(columns[1]), 0}:
            if phase < gap and np.array_equal(columns_of(width, gap, phase), columns):
                return _REGULAR, _STEP.pack(gap, phase)
    gaps = np.diff(columns.astype("<u2"), prepend=np.uint16(0)).astype("<u2")
    return _LISTED, zlib.compress(gaps.tobytes(), 9)


def _read_columns(kind: int, width: int, data: bytes) -> Columns:
    if kind == _REGULAR and len(data) == _STEP.size:
        step, phase = _STEP.unpack(data)
        if not phase < step:
            raise SectionError(f"a lattice of every {step}. column from {phase} on")
        return columns_of(width, step, phase)
    if kind != _LISTED:
        raise SectionError(f"a lattice section of kind {kind} with {len(data)} bytes of columns")
    gaps = inflated(data, 2 * width)
    if gaps is None or len(gaps) % 2:
        raise SectionError("a lattice section whose list of columns is damaged")
    columns = np.frombuffer(gaps, "<u2").astype(np.int64).cumsum()
    if len(columns) and (int(columns[-1]) >= width or np.any(np.diff(columns) < 1)):
        raise SectionError(f"a lattice section with columns beyond the {width} of its frame, or twice")
    return columns.astype(np.uint16)

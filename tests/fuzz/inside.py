"""LATTICE and POSITION sections with damage inside of what they pack, and all around it right again.

A wound in packed bytes is found when they are unpacked, and nothing behind it is tried. So they are unpacked first,
damaged and packed anew, with sizes that agree; now and then with one that does not.
"""

from __future__ import annotations

import random
import struct
import zlib

import numpy as np
import numpy.typing as npt
import zstandard

from lidarcodec.entropy import decode_positions, fast
from lidarcodec.entropy.number_series import differences
from lidarcodec.entropy.varint import put_signed, put_varint
from lidarcodec.errors import LidarCodecError
from lidarcodec.units import MAX_COLUMNS, MAX_PACKETS, MAX_POSITION_BYTES
from tests.fuzz.mutations import EXTREMES, wounded

_HEAD = struct.Struct("<BHHHI")
_MOST_GAPS = 2 * MAX_COLUMNS
_REGULAR, _LISTED = 0, 1
_FAR = (-(2**63), -(2**62), -1, 0, 1, 2, 3, MAX_POSITION_BYTES + 1, 2**31, 2**62, 2**63 - 1)


def damaged_lattice(data: bytes, rng: random.Random) -> bytes:
    """A LATTICE section with one part damaged; any bytes that are no such section are wounded as they are."""
    if len(data) < _HEAD.size:
        return wounded(data, rng)
    kind, width, packets, listed, size = _HEAD.unpack_from(data)
    behind = _HEAD.size + listed
    columns, side, positions = data[_HEAD.size : behind], data[behind : behind + size], data[behind + size :]
    match rng.randrange(8):
        case 0:
            width = _near(width, MAX_COLUMNS, rng)
        case 1:
            packets = _near(packets, MAX_PACKETS, rng)
        case 2:
            step = rng.choice((0, 1, 2, 3, 64, width, MAX_COLUMNS, 65535))
            kind, columns = _REGULAR, struct.pack("<HH", step & 65535, rng.choice((0, 1, step - 1, step)) & 65535)
        case 3 | 4:
            kind, columns = _LISTED, zlib.compress(_gaps(kind, columns, width, rng))[:65535]
        case 5:
            side = wounded(side, rng)
        case 6:
            positions = damaged_positions(positions, rng) if positions else rng.randbytes(rng.randrange(30))
        case _:
            kind, size = rng.choice((kind, rng.randrange(256))), rng.choice((0, (size + 1) % 2**32, 2**32 - 1))
            return _HEAD.pack(kind, width, packets, len(columns), size) + columns + side + positions
    return _HEAD.pack(kind, width, packets, len(columns), len(side)) + columns + side + positions


def _near(value: int, most: int, rng: random.Random) -> int:
    return max(0, min(rng.choice((0, 1, value - 1, value + 1, 2 * value, most, most + 1, rng.randrange(most))), 65535))


def _gaps(kind: int, columns: bytes, width: int, rng: random.Random) -> bytes:
    """Distances from column to column, u16 each: those of the section damaged, or any."""
    if kind == _LISTED and rng.random() < 0.7:
        try:
            return wounded(zlib.decompressobj().decompress(columns, _MOST_GAPS), rng)
        except zlib.error:
            pass
    count = rng.choice((0, 1, 2, width, width + 1, rng.randrange(width + 1)))
    gap = rng.choice((0, 1, 2, 64, 65, max(width - 1, 0) // max(count - 1, 1), 65535))
    gaps = np.full(count, gap, "<u2")
    gaps[:1] = rng.choice((0, 0, 1, 65535))
    return gaps.tobytes() + bytes(rng.choice((0, 0, 0, 1, 1_000_000)))


def damaged_positions(data: bytes, rng: random.Random) -> bytes:
    """A POSITION section with one number or some payload bytes damaged; other bytes are wounded as they are."""
    try:
        known = decode_positions(data, MAX_PACKETS)
    except LidarCodecError:
        return wounded(data, rng)
    count, kind, form, level, rate, step = len(known), 0, rng.randrange(4), 0, 0, 1
    payloads = b"".join(one.payload for one in known)
    series: list[npt.NDArray[np.int64]] = [
        differences(np.array([one.place for one in known], np.int64), 1),
        differences(np.array([len(one.payload) for one in known], np.int64), 1),
        np.array([one.offset_ns // 1000 for one in known], np.int64),
    ]
    for _ in range(rng.choice((0, 1, 1, 3))):
        rng.choice(series)[rng.randrange(count)] = rng.choice(_FAR)
    match rng.randrange(6):
        case 0:
            kind = rng.choice((1, 1, 2, 255))
        case 1:
            level, rate = rng.choice(_FAR), rng.choice(_FAR)
        case 2:
            step = rng.choice((0, 10**9, 10**9 + 1, *EXTREMES))
        case 3:
            form = rng.randrange(256)
        case 4:
            payloads = wounded(payloads, rng)
        case _:
            kind = int(len({len(one.payload) for one in known}) == 1)
    out = bytearray([kind])
    put_varint(out, count)
    put_varint(out, step)
    out.append(form)
    put_signed(out, level)
    put_signed(out, rate)
    numbers = fast.encode_signed(series)
    put_varint(out, len(numbers))
    stated = rng.random() < 0.9
    packed = zstandard.ZstdCompressor(level=1, write_content_size=stated).compress(payloads)
    return bytes(out) + numbers + (packed if rng.random() < 0.7 else payloads)

"""Inputs for the harnesses of native/fuzz that read planes and points of other sensors than the HDL-64E: each harness's
own first bytes, then what is coded, or numbers."""

from __future__ import annotations

import struct
from collections.abc import Iterator

import numpy as np

from lidarcodec import _native
from lidarcodec.entropy import plane_coder
from lidarcodec.entropy.varint import put_signed, put_varint
from tests.entropy.driven import Form

_TURNS = (1, 2, 36_000, 1 << 16, (1 << 18) + 1, 1 << 28)
"""Steps of a turn that fuzz_clouds knows, by number."""


def clouds(rng: np.random.Generator) -> Iterator[bytes]:
    """For fuzz_clouds: rests and sums as they are coded, of the smallest and the largest numbers, and what makes every
    kind of coordinates."""
    for rows, columns, kind, holes in ((0, 0, 0, 0), (8, 39, 1, 0), (3, 30, 2, 100), (8, 39, 7, 200), (0, 39, 3, 255)):
        image = bytes([rows, columns, kind, holes])
        row, column = (part.ravel() for part in np.indices((rows + 1, columns + 1)))
        cells = rows + 1, columns + 1, row.astype(np.int64), column.astype(np.int64)
        for most in (1, 2, 17, 1 << 28):
            rests = rng.integers(0, most, row.size, np.uint32)
            coded = _native.encode_field_rests(cells, rests)
            for part in (2, 3):  # rests of fields, and what is left of sums
                yield bytes([part, 1]) + image + b"\0\0\0" + coded
            yield bytes([0, 0]) + image + bytes([1, 2, 1]) + b"\0" + 4 * (bytes([len(coded) % 128]) + coded)
        for turn in range(len(_TURNS)):
            for more in (0, 1, 33, 34, 65, 66, 5, 9):
                for how in (0, 2, 6, 8, 24, 32, 96, 1):
                    head = bytes([1, how]) + image + bytes([2, turn + 8 * (more % 5) + 64 * (how % 2), more])
                    yield head + rng.bytes(60)
        for part in (3, 4, 5):
            for how in (0, 1, 4, 8, 16, 31):
                yield bytes([part, how]) + image + b"\0\0\0" + rng.bytes(300)


_PLANES = (
    Form("range", 20, "range"),
    Form("range2", 20, "second range"),
    Form("intensity", 8, "attribute"),
    Form("intensity2", 8, "attribute", "range2"),
    Form("signal", 16, "attribute"),
)
_PLANE_KINDS = ((0, 19), (4, 19), (2, 7), (38, 7), (2, 15))
"""Role, likeness and range plane of each of them, and its bits, as fuzz_images reads them."""


def _moved(following: bytes, columns: int) -> bytes:
    """A frame after another one of as many columns, by a sensor that drove ahead and turned a little."""
    directions = bytearray([6])
    for number in (1 << 30, 1, columns - 1, (1 << 32) // columns >> 5):
        put_varint(directions, number)
    for part in (-90, 40, 600, -5700, 3, -8):
        put_signed(directions, part)
    return following[:4] + bytes(directions) + following[5:]


def planes(rng: np.random.Generator) -> Iterator[bytes]:
    """For fuzz_images: a dual frame as it is coded, of all sizes and steps, alone and after another, and numbers to be
    coded."""
    for rows, columns in ((0, 0), (1, 1), (1, 24), (8, 1), (5, 9), (8, 24)):
        for step in (1, 3, 127):
            for most in (1, 2, 300, 2**20):
                head = struct.pack(">B3H2B", 0, rows, columns, step // 2, 0, len(_PLANES) - 1)
                head += b"".join(struct.pack("2B", *kind) for kind in _PLANE_KINDS)
                shape = (rows, columns)
                images = {of.name: rng.integers(0, min(most, 1 << of.bits), shape, np.uint32) for of in _PLANES}
                images["range2"] = np.where(rng.random(shape) < 0.9, images["range"], images["range2"])
                for quick in (False, True):
                    shift = np.zeros(rows, np.int32)
                    yield head + plane_coder.encode_planes(_PLANES, images, shift, step, quick=quick)
                if step > 1 or most < 2**20:  # a frame after another, as it is coded
                    memory, runs = plane_coder.PlaneMemory(), np.array([[columns, 0]], np.uint32)
                    memory.encode(_PLANES, images, shift, step)
                    following = memory.encode(_PLANES, images, shift, step, runs[: columns > 0])
                    yield bytes([64 + 16]) + head[1:] + following
                    if rows > 1 and columns > 1:
                        yield bytes([64 + 16]) + head[1:] + _moved(following, columns)
                for kind in (1, 2 + 8, 16, 16 + 32 + 4, 64, 64 + 4 + 8, 64 + 32, 64 + 32 + 128):
                    yield bytes([kind]) + head[1:] + rng.integers(0, min(most, 256), 200, np.uint8).tobytes()


def plane_motions(rng: np.random.Generator) -> Iterator[bytes]:
    """For fuzz_plane_motion: rooms and any ranges, motions small and large, and directions as they are sent."""
    for kind in (0, 1, 2, 4, 8, 12, 16, 16 + 32, 16 + 32 + 64, 16 + 4, 16 + 3, 128):
        for directions in (0, 1, 2, 3, 4, 9, 31, 255):
            for rows, columns, before in ((0, 0, 0), (14, 178, 178), (6, 178, 60), (14, 30, 178)):
                head = bytes([kind, directions, rows, columns, before])
                coded = bytearray()
                for number in (1 << 30, 1, columns + 1, (1 << 32) // (columns + 2)):
                    put_varint(coded, number)
                for row in range(rows + 2):
                    put_signed(coded, 60_000 - 6_000 * row)
                    put_signed(coded, row % 3)
                for part in (-90, 40, 600, -5700, 3, -8):
                    put_signed(coded, part)
                yield head + rng.bytes(64)
                yield head + bytes(coded)

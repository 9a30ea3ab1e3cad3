"""Inputs for the harnesses of native/fuzz that hold valid sections: each harness's own first bytes, then the section.

A harness makes the geometry of a frame of its first bytes (native/fuzz/parts/fuzz_geometry.hpp). The same geometry is
made here, and a section is written for it by the encoder, so that the harness decodes it and goes there and back.
"""

from __future__ import annotations

import random
import struct
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from lidarcodec import _native
from lidarcodec.assembly import packets_of
from lidarcodec.codecs.pcodec import compress_groups
from lidarcodec.entropy import encode_azimuth, fast
from lidarcodec.units import BLOCKS_PER_PACKET, LASERS
from tests.fuzz import extremes, other_seeds, session_seeds
from tests.fuzz.inside_others import damaged_json
from tests.sensors.ouster_packets import PIXELS, as_json, flat_metadata, nested_metadata

Mask = npt.NDArray[np.bool_]
_WHOLE = -1
_NUMBER = np.uint64(2654435761)
_PATTERNS = (0, 0xFF, 0x55, 0x01)
"""Which of eight halves of columns fired; 0: all of them."""
_FILLS = (b"\0", b"\xff", b"\0\xff", b"\x7f\x80", bytes(range(256)))


class Geometry(NamedTuple):
    """What `FuzzGeometry` is. fired: (2, W) bool; half, rotation: (64,)."""

    fired: Mask
    half: npt.NDArray[np.uint8]
    rotation: npt.NDArray[np.int32]

    @classmethod
    def of(cls, width: int, pattern: int, turned: int, *, mixed: bool) -> Geometry:
        """The geometry of a harness's first bytes."""
        i, rows = np.arange(2 * width), np.arange(LASERS)
        fired = np.ones(2 * width, np.bool_) if pattern == 0 else (pattern >> (i % 8) & 1).astype(np.bool_)
        half = (rows % 3 == 0 if mixed else rows >= LASERS // 2).astype(np.uint8)
        rotation = (turned * rows.astype(np.uint32) * np.uint32(40503001)).astype(np.uint32).view(np.int32)
        return cls(fired.reshape(2, width), half, rotation)

    @property
    def given(self) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.uint8], npt.NDArray[np.int32]]:
        """As the native coders take it."""
        return self.fired.view(np.uint8), self.half, self.rotation

    @property
    def cells(self) -> Mask:
        """(64, W) bool, cells whose half fired."""
        return np.ascontiguousarray(self.fired[self.half.astype(np.intp)])

    def returns(self, holes: int) -> Mask:
        """(64, W) bool; the more holes of 255, the fewer."""
        i = np.arange(self.cells.size, dtype=np.uint64).reshape(self.cells.shape)
        return self.cells & ((i * _NUMBER >> np.uint64(7)) % np.uint64(256) >= np.uint64(holes))


def _ways(most: int) -> Iterator[tuple[int, int, int, bool]]:
    """Width, pattern, turned, mixed: every width that is special with something of all else."""
    for at, width in enumerate((0, 1, 2, 7, most // 2, most)):
        for pattern in _PATTERNS:
            yield width, pattern, (0, 1, 255)[at % 3], bool(at % 2)


def _shapes(cells: Mask, rng: np.random.Generator) -> dict[str, Mask]:
    """Masks of all kinds within cells that fired."""
    row, column = np.indices(cells.shape)
    return {
        "none": np.zeros_like(cells),
        "all": cells,
        "checked": cells & ((row + column) % 2 == 0),
        "noise": cells & (rng.random(cells.shape) < 0.5),
        "few": cells & (rng.random(cells.shape) < 0.03),
        "rows": cells & (row % 2 == 0),
    }


def masks(rng: np.random.Generator) -> Iterator[bytes]:
    """For fuzz_mask."""
    for width, pattern, turned, mixed in _ways(47):
        of, split = Geometry.of(width, pattern, turned, mixed=mixed), 200 if mixed else 50
        for kind in (2, 3):
            wide = 1 + split % 40 if kind & 1 else 0
            earlier = ((np.arange(LASERS * wide) * 7 + split) % 11 > 2).reshape(LASERS, wide)
            for mask in _shapes(of.cells, rng).values():
                section = _native.encode_mask(mask.view(np.uint8), *of.given, earlier.view(np.uint8), 0)
                yield struct.pack(">H4BH", width, pattern, turned, split, kind, 0) + section


def keeps(rng: np.random.Generator) -> Iterator[bytes]:
    """For fuzz_keep."""
    for width, pattern, turned, mixed in _ways(47):
        of, split, step = Geometry.of(width, pattern, turned, mixed=mixed), 200 if mixed else 50, 18
        turns = (np.arange(2 * width) % max(width, 1) * step % 36000).astype(np.uint16).reshape(2, width)
        for kind in (0, 1):
            wide = width if kind & 1 else 0
            earlier = ((np.arange(LASERS * wide) * 7 + split) % 11 > 8).reshape(LASERS, wide)
            for keep in _shapes(of.cells, rng).values():
                section = _native.encode_keep(keep.view(np.uint8), turns, *of.given, earlier.view(np.uint8))
                yield struct.pack(">H4BH", width, pattern, turned, split, kind, step) + section


def intensities(rng: np.random.Generator) -> Iterator[bytes]:
    """For fuzz_intensity."""
    for width, pattern, turned, mixed in _ways(12):
        of, kind = Geometry.of(width, pattern, turned, mixed=mixed), 4 if mixed else 0
        for holes in (0, 100, 255):
            returns = of.returns(holes)
            for levels in (1, 2, 16, 256):
                values = (rng.integers(0, levels, returns.shape) * 255 // max(levels - 1, 1) * returns).astype(np.uint8)
                for memory in (None, _native.IntensityMemory(True)):
                    given = (values, returns.view(np.uint8), *of.given, 0)
                    section = _native.encode_intensity(*given, memory, np.zeros((2, width), np.uint16))
                    yield struct.pack(">H6BH", width, pattern, holes, turned, kind, 0, 0, 0) + section


def layers(rng: np.random.Generator) -> Iterator[bytes]:
    """For fuzz_layers: refined ranges of all steps, exact and not, of bases that are everywhere the same or slopes."""
    for width, pattern, turned, mixed in _ways(12):
        of, kind = Geometry.of(width, pattern, turned, mixed=mixed), 4 if mixed else 0
        level = (np.arange(LASERS) * turned % 1001).astype(np.int32)
        for holes, spread in ((0, 64), (100, 71), (255, 3)):
            returns = of.returns(holes)
            at = np.arange(returns.size).reshape(returns.shape)
            base = ((1 + (spread * 257 + at * (spread % 16)) % 65535) * returns).astype(np.uint16)
            for wide, fine in ((24, 0), (0, 0), (24, 5), (400, 0)):
                steps = 3 + 2 * wide, 1 + 2 * (fine % (wide + 1))
                by = rng.integers(-(wide + 1), wide + 2, base.shape)
                ranges = np.where(base > 0, (base.astype(int) + by).clip(1, 65535), 0).astype(np.uint16)
                section = _native.encode_refinement(ranges, base, *of.given, level, *steps, 300)
                yield struct.pack(">H4B3HB", width, pattern, holes, turned, kind, wide, fine, 300, spread) + section


def levels(rng: np.random.Generator) -> Iterator[bytes]:
    """For fuzz_levels, which takes intensities as they are: few and many, in any number of levels."""
    for width, pattern, turned, mixed in _ways(12):
        for count in (2, 3, 16, 64, 65, 255):
            kind = 4 * mixed + (rng.integers(0, 2) if width % 2 else 0)
            head = struct.pack(">H7B", width, pattern, 30, turned, kind, count, 40, 100)
            yield head + rng.choice(rng.integers(0, 256, count), 150).astype(np.uint8).tobytes()


class Coded(NamedTuple):
    """How ranges are coded: their step, whether something is expected, quickly, freely, as a slab, and in halves."""

    step: int
    expects: bool = False
    quick: bool = False
    free: bool = False
    slab: bool = False
    halves: bool = False


_CODED = (
    Coded(1),
    Coded(1, expects=True),
    Coded(63, quick=True),
    Coded(63, expects=True, free=True),
    Coded(63, expects=True, free=True, halves=True),
    Coded(1, quick=True, halves=True),
    Coded(5, quick=True, free=True, slab=True),
)
_FREE = tuple(Coded(step, bool(n & 1), bool(n & 2), True, bool(n & 4)) for step in (3, 63) for n in range(8))
_FREE += tuple(Coded(63, bool(n & 1), bool(n & 2), free=True, halves=True) for n in range(4))
_EXPECTS, _SLAB, _MIXED = 16, 64, 4


def _images(shape: tuple[int, ...], rng: np.random.Generator) -> tuple[npt.NDArray[np.int64], ...]:
    """Ranges of all kinds: the farthest, the nearest, surfaces, noise."""
    smooth = 3000 + 40 * np.arange(LASERS)[:, None] + rng.integers(0, 9, shape)
    return np.full(shape, 65535), np.ones(shape, np.int64), smooth, rng.integers(1, 65536, shape)


def _guesses(shape: tuple[int, ...]) -> npt.NDArray[np.uint16]:
    """What the harnesses expect."""
    i = np.arange(shape[0] * shape[1], dtype=np.uint64)
    known = np.where(i % np.uint64(5) != 0, i * np.uint64(40503) >> np.uint64(7), 0).astype(np.uint16)
    return known.reshape(shape)


def _section(of: Geometry, returns: Mask, image: npt.NDArray[np.int64], how: Coded, turned: int, known: int) -> bytes:
    """A section of ranges, all but its step. known: columns on the left that a slab goes on from."""
    level = (turned * np.arange(LASERS) % 1001).astype(np.int32)
    guesses = _guesses(returns.shape)
    coded = np.where(returns, image, 0).astype(np.uint16)
    coded[:, :known] = guesses[:, :known] | 1
    expected = guesses if how.expects else np.zeros((LASERS, 0), np.uint16)
    sent = np.zeros_like(coded) if how.free else np.zeros((LASERS, 0), np.uint16)
    past = known if how.slab else _WHOLE
    given = (coded, returns.view(np.uint8), how.step, level, *of.given, 0, 0, expected, past, None)
    return _native.PredictiveCoder().encode(*given, how.quick, sent, how.halves)


def ranges(rng: np.random.Generator) -> Iterator[bytes]:
    """For fuzz_predictive: without networks, something expected or not, rounded and free, frames and slabs."""
    for width, pattern, turned, mixed in _ways(19):
        of = Geometry.of(width, pattern, turned, mixed=mixed)
        for holes in (0, 100):
            returns = of.returns(holes)
            for image in _images(returns.shape, rng):
                for how in _CODED:
                    known = holes % (width + 1) if how.slab else 0
                    kind = _MIXED * mixed + _EXPECTS * how.expects + _SLAB * how.slab
                    head = struct.pack(">H4BHB", width, pattern, holes, turned, kind, 0, how.step // 2)
                    yield head + _section(of, returns, image, how, turned, known)


def free_ranges(rng: np.random.Generator) -> Iterator[bytes]:
    """For fuzz_free: whole sections of every kind without networks, and images."""
    whole_section = 2
    for width, pattern, turned, mixed in _ways(6):
        if not width:
            continue
        of = Geometry.of(width, pattern, turned, mixed=mixed)
        rows = (1, 0x81, 255)[width % 3]
        returns = of.returns(0) & (rows >> np.arange(LASERS) % 8 & 1).astype(np.bool_)[:, None]
        for image in _images(returns.shape, rng):
            for how in _FREE:
                known = 3 % (width + 1) if how.slab else 0
                kind = _MIXED * mixed + _EXPECTS * how.expects + _SLAB * how.slab + 128 * how.quick
                head = struct.pack(
                    ">8BHB",
                    width - 1,
                    pattern,
                    rows,
                    0,
                    turned,
                    kind,
                    4 * (known or how.halves) + whole_section,
                    0,
                    0,
                    how.step // 2 - 1,
                )
                yield head + _section(of, returns, image, how, turned, known)
        yield struct.pack(">8BHB", width - 1, pattern, 0x24, 30, turned, _MIXED * mixed, 0, 2, 0, 24) + rng.bytes(99)


def azimuths(_: np.random.Generator) -> Iterator[bytes]:
    """For fuzz_azimuth."""
    for seed in (1, 2):
        for frame in extremes.small(seed, 8):
            if frame.width < 500:
                yield struct.pack(">H", frame.width) + encode_azimuth(frame.azimuth, frame.fired)


def numbers(rng: np.random.Generator) -> Iterator[bytes]:
    """For fuzz_numbers: its three streams."""
    for counts in ((0, 0, 0), (1, 0, 0), (99, 299, 19), (5, 60, 3)):
        for most in (1, 2, 256, 2**32, 2**63):
            streams = [rng.integers(0, most, count, dtype=np.uint64) for count in counts]
            yield struct.pack(">3H", *counts) + fast.encode_numbers(streams)
        yield struct.pack(">3H", *counts) + fast.encode_numbers([np.full(n, 2**64 - 1, np.uint64) for n in counts])


def pco(rng: np.random.Generator) -> Iterator[bytes]:
    """For fuzz_pco: ranges in groups, and one chunk of them."""
    for size in (1, 3, 255, 257, 1999):
        for spread in (1, 3, 300, 40000):
            values = rng.integers(1, 1 + spread, size).astype(np.uint16)
            for level in (1, 8, 12):
                coded = compress_groups(values, level)
                yield struct.pack(">BH", 0, size) + coded
                yield struct.pack(">BH", 1, size) + coded[1 + 5 * coded[0] :]


def packets(_: np.random.Generator) -> Iterator[bytes]:
    """For fuzz_assembly: whole payloads, and heads of blocks."""
    for frame in extremes.small(1, 2):
        if frame.side is not None:
            yield b"\0" + b"".join(packet.payload for packet in packets_of(frame))
    for fill in _FILLS:
        yield b"\1" + (fill * 2 * BLOCKS_PER_PACKET * 4)[: 2 * BLOCKS_PER_PACKET * 4]


def plain(_: np.random.Generator) -> Iterator[bytes]:
    """For harnesses that take numbers and no section: every kind they know, with numbers at their limits."""
    for kind in (0, 1, 2, 4, 8, 16, 32, 64, 128, 255):
        for fill in _FILLS:
            yield bytes([kind, 0, 40, 0, 30, 0, 18]) + (fill * 1024)[:1024]


def streams_of_masks(rng: np.random.Generator) -> Iterator[bytes]:
    """For fuzz_mask_stream, which writes valid masks itself: every kind, without damage and with a little."""
    for width, pattern, turned, mixed in _ways(47):
        for kind in (64, 66, 72, 74, 78, 90, 106, 127):
            damage = rng.bytes(2 * int(rng.integers(0, 4)))
            yield struct.pack(">H4B", width, pattern, turned, kind | mixed, 40) + damage


def streams(rng: np.random.Generator) -> Iterator[bytes]:
    """For fuzz_session: messages of every codec that a session decodes."""
    return session_seeds.sessions(int(rng.integers(0, 100)))


def streams_of_others(rng: np.random.Generator) -> Iterator[bytes]:
    """For fuzz_others: the same of other sensors than the HDL-64E."""
    return session_seeds.others(int(rng.integers(0, 100)))


def metadata(rng: np.random.Generator) -> Iterator[bytes]:
    """For fuzz_metadata: the metadata of Ousters, flat and nested, whole and with a part changed."""
    numbers = random.Random(int(rng.integers(0, 1 << 30)))
    for profile in PIXELS:
        flat = flat_metadata(profile, 16, "OS-0-16")
        for tree in (flat, nested_metadata(flat)):
            whole = as_json(tree)
            yield whole
            for _ in range(12):
                yield damaged_json(whole, numbers)


HARNESSES = {
    "fuzz_clouds": other_seeds.clouds,
    "fuzz_images": other_seeds.planes,
    "fuzz_plane_motion": other_seeds.plane_motions,
    "fuzz_mask": masks,
    "fuzz_keep": keeps,
    "fuzz_intensity": intensities,
    "fuzz_layers": layers,
    "fuzz_levels": levels,
    "fuzz_predictive": ranges,
    "fuzz_free": free_ranges,
    "fuzz_azimuth": azimuths,
    "fuzz_numbers": numbers,
    "fuzz_pco": pco,
    "fuzz_assembly": packets,
    "fuzz_groups": plain,
    "fuzz_reduction": plain,
    "fuzz_riddle_train": plain,
    "fuzz_warp": plain,
    "fuzz_mask_stream": streams_of_masks,
    "fuzz_session": streams,
    "fuzz_others": streams_of_others,
    "fuzz_metadata": metadata,
}
"""Where the inputs of each harness come from."""


def seeds(harness: str, seed: int) -> list[bytes]:
    """Inputs for a harness of native/fuzz, none twice."""
    return list(dict.fromkeys(HARNESSES[harness](np.random.default_rng(seed))))

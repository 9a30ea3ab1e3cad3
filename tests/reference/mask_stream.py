"""The mask coder of streams with memory in pure Python: bytes as of native/src/mask/stream.cpp, to read and to test."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from lidarcodec.errors import SectionError, TruncatedError
from tests.reference.mask import ROWS, closed_rows
from tests.reference.range_coder import MIN_PROBABILITY, SQUASH, BitModel, BitReader, Bits, BitWriter
from tests.reference.warp import angle_of_table, cos_sin, rounded30

BEGINS, GOES_ON = 6, 7
DIRECTIONS: Final = 4096
BLOCK: Final = 16
"""Directions that move as one."""
MARGIN: Final = 8
LIMITS: Final = (1, 2, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128)
SURE: Final = 256
RATE: Final = 123
MOST_MOVED: Final = 1 << 20
MOST_TURNED: Final = 1 << 30

Mask = npt.NDArray[np.uint8]
Around = dict[int, int]
"""Numbers of the cells of a row, those beyond its ends too."""


class View(NamedTuple):
    """What both ends know of a frame before its mask.

    azimuth, fired: (2, W); beams: (6, 64), of each row half, rotation, elevation and more; motion: twelve numbers
    expected: (64, W), or None where nothing is
    """

    azimuth: npt.NDArray[np.uint16]
    fired: Mask
    beams: npt.NDArray[np.int32]
    expected: npt.NDArray[np.uint16] | None
    motion: list[int]


def class_of(count: int) -> int:
    """How many of LIMITS a count reaches."""
    return sum(count >= limit for limit in LIMITS)


def range_class(expected: int) -> int:
    """0 nothing, 1 below 2 m, then octaves up to 7."""
    return 0 if expected == 0 else max(1, min(7, expected.bit_length() - 9))


def roughness(here: int, others: list[int]) -> int:
    """How far the ranges beside one lie from it: 0 nothing is expected, 1 to 7."""
    if here == 0:
        return 0
    apart = sum(min(abs(there - here), here >> 3 if there == 0 else here >> 2) for there in others)
    return 1 + sum(apart > here >> part for part in range(1, 7))


def zeros(byte: int, bits: int) -> int:
    """Holes among the lowest bits of a byte of turns."""
    return bits - (byte & ((1 << bits) - 1)).bit_count()


class MaskStreamReference:
    """What a stream remembers, and how it codes."""

    def __init__(self) -> None:
        self.begun = False
        self._forget()

    def _forget(self) -> None:
        self.beams = [[255] * DIRECTIONS for _ in range(ROWS)]
        self.places = [[255] * DIRECTIONS for _ in range(ROWS)]
        self.gates: dict[int, BitModel] = {}
        self.cells: dict[tuple[int, int], int] = {}
        self.left_over = 0

    def encode(self, mask: Mask, view: View) -> bytes:
        """Bytes of a (64, W) mask."""
        columns = _columns(view)
        rows, alike = closed_rows(mask, columns)
        if alike is not None:
            return alike
        kind, bits = GOES_ON if self.begun else BEGINS, BitWriter()
        self._code(bits, view, kind == BEGINS, rows)
        return bytes([kind]) + bits.finish()

    def decode(self, data: bytes, view: View) -> Mask:
        """(64, W). Raises SectionError or TruncatedError."""
        if not data:
            raise TruncatedError("a mask section holds no bytes")
        if data[0] not in (BEGINS, GOES_ON) or (data[0] == GOES_ON and not self.begun):
            raise SectionError("a mask section of an unknown kind, or one that goes on from nothing")
        columns, bits = _columns(view), BitReader(data[1:])
        rows = [[0] * len(columns[row]) for row in range(ROWS)]
        self._code(bits, view, data[0] == BEGINS, rows)
        bits.finish()
        mask = np.zeros((ROWS, view.fired.shape[1]), np.uint8)
        for row in range(ROWS):
            mask[row, columns[row]] = rows[row]
        return mask

    def _code(self, bits: Bits, view: View, fresh: bool, rows: list[list[int]]) -> None:
        if fresh:
            self._forget()
        self.begun = True
        columns, moved = _columns(view), [list(row) for row in self.places]
        for row in range(ROWS):
            if not columns[row]:
                continue
            at = self._directions(view, row, columns[row])
            beams = {down: self._turns(self.beams, row + down, at) for down in range(-3, 2)}
            places = self._places_of(view, row, at, columns[row])
            self._code_row(bits, view, row, columns[row], rows[row], beams, places)
            for k, bit in enumerate(rows[row]):
                apart = (at[k + 1] - at[k]) % DIRECTIONS if k + 1 < len(rows[row]) else 2
                for j in range(apart if 1 <= apart <= 8 else 1):
                    own = (at[k] + j) % DIRECTIONS
                    self.beams[row][own] = 255 * bit if fresh else (2 * beams[0][k] + bit) & 255
                    moved[row][own] = 255 * bit if fresh else (2 * places[0][k] + bit) & 255
        self.places = moved

    @staticmethod
    def _directions(view: View, row: int, columns: list[int]) -> Around:
        azimuth = view.azimuth[view.beams[0, row]]
        aside = ((angle_of_table(int(view.beams[1, row])) + (1 << 19)) >> 20) % DIRECTIONS
        at = {k: int(azimuth[column]) * DIRECTIONS // 36000 - aside for k, column in enumerate(columns)}
        last = len(columns) - 1
        for j in range(1, MARGIN + 1):
            at[-j], at[last + j] = at[0] - 2 * j, at[last] + 2 * j
        return {k: direction % DIRECTIONS for k, direction in at.items()}

    @staticmethod
    def _turns(table: list[list[int]], row: int, at: Around) -> Around:
        return {k: table[row][direction] if 0 <= row < ROWS else 255 for k, direction in at.items()}

    def _places_of(self, view: View, row: int, at: Around, columns: list[int]) -> dict[int, Around]:
        nearest: dict[int, int] = {}
        for k, column in enumerate(columns):
            expected = 0 if view.expected is None else int(view.expected[row, column])
            if expected or at[k] // BLOCK not in nearest:
                nearest[at[k] // BLOCK] = expected or nearest.get(at[k] // BLOCK, 0)
        moved = {block: _moved(view, row, block, expected) for block, expected in nearest.items()}
        found: dict[int, Around] = {-1: {}, 0: {}, 1: {}}
        for k in range(len(columns)):
            then, by = moved[at[k] // BLOCK]
            for down, around in found.items():
                around[k] = self._turns(self.places, then + down, {0: (at[k] + by) % DIRECTIONS})[0]
        return {down: _padded(around, len(columns)) for down, around in found.items()}

    def _code_row(
        self,
        bits: Bits,
        view: View,
        row: int,
        columns: list[int],
        cells: list[int],
        beams: dict[int, Around],
        places: dict[int, Around],
    ) -> None:
        u, v, w, h, b = (beams[down] for down in (-1, -2, -3, 0, 1))
        p, pa, pb = (places[down] for down in (0, -1, 1))
        expected = {
            k: 0 if view.expected is None else int(view.expected[row, column]) for k, column in enumerate(columns)
        }
        e = _padded(expected, len(columns))
        left, run = [1] * 12, 0
        for k in range(len(columns)):
            nine = range(k - 4, k + 5)
            above = sum(3 - (u[i] & 1) - (v[i] & 1) - (w[i] & 1) for i in nine)
            wide = sum(3 - (u[i] & 1) - (v[i] & 1) - (w[i] & 1) for i in range(k - 8, k + 9))
            changed = sum(((u[i] ^ u[i] >> 1) & 1) + ((v[i] ^ v[i] >> 1) & 1) for i in nine)
            around = sum(zeros(h[i], 4) + zeros(b[i], 3) for i in nine)
            new = sum(zeros(p[i], 2) + zeros(pa[i], 1) + zeros(pb[i], 1) for i in nine)
            ever = sum(zeros(p[i], 8) + (zeros(pa[i], 8) + zeros(pb[i], 8) + 1) // 2 for i in nine)
            missing, holes = sum(1 - (h[i] & 1) for i in nine), 12 - sum(left)
            l1, l2, u0, h0, u1, h1 = left[0], left[1], u[k] & 1, h[k] & 1, u[k + 1] & 1, h[k + 1] & 1
            few = holes if holes < 2 else 2 if holes < 4 else 3
            gate = min(class_of(ever), 7) | min(class_of(above), 7) << 3 | few << 6
            gate |= l1 << 8 | u0 << 9 | h0 << 10 | min(class_of(around), 7) << 11
            model = self.gates.setdefault(gate, BitModel())
            sure = model.probability()
            if sure < SURE or sure > 65536 - SURE:
                bit = bits.bit(cells[k], sure)
            else:

                def of(turns: Around, first: int, last: int, turn: int = 0, k: int = k) -> int:
                    return sum((turns[k + j] >> turn & 1) << (j - first) for j in range(first, last + 1))

                sides, three = l1 | u0 << 1, l1 | u0 << 1 | h0 << 2
                near, there, c = range_class(e[k]), class_of(new), class_of(holes)
                often = 2 if zeros(h[k] >> 1, 7) < 2 else 1 if zeros(h[k] >> 1, 7) < 5 else 0
                about = 3 if missing == 0 else 2 if missing < 3 else 1 if missing < 9 else 0
                rough = roughness(e[k], [e[k - 2], e[k - 1], e[k + 1], e[k + 2]])
                numbers = (
                    three | (v[k + 1] & 1) << 3 | about << 4 | l2 << 6,
                    three | (u[k - 1] & 1) << 3 | u1 << 4 | (h[k - 3] & 1) << 5 | (h[k - 1] & 1) << 6 | h1 << 7
                    | run << 8,
                    sides | of(h, -3, 3) << 2 | l2 << 9,
                    three | near << 3 | range_class(e[k - 1]) << 6 | range_class(e[k + 1]) << 9,
                    three | near << 3 | rough << 6 | often << 9,
                    l1 | h0 << 1 | l2 << 2 | of(u, -3, 4) << 3,
                    three | of(v, -1, 2) << 3 | of(w, 0, 1) << 7 | u1 << 9,
                    three | of(h, -2, 2, 1) << 3 | of(h, -1, 1, 2) << 8,
                    sides | near << 2 | row << 5,
                    three | class_of(changed) << 3 | class_of(around) << 7,
                    three | (p[k] & 1) << 3 | there << 4 | c << 8,
                    three | p[k] << 3,
                    three | h1 << 3 | class_of(ever) << 4 | class_of(above) << 8,
                    sides | u1 << 2 | c << 3 | class_of(wide) << 6 | run << 10,
                    three | (h[k] >> 1 & 3) << 3 | h1 << 5 | (h[k - 1] & 1) << 6 | of(b, 0, 1) << 7 | u1 << 9 | l2 << 10
                    | (u[k] >> 1 & 1) << 11,
                    three | row << 3 | min(there, 7) << 9,
                )  # fmt: skip
                bit = self._by_contexts(bits, cells[k], numbers)
            model.update(bit)
            cells[k] = bit
            run = min(run + 1, 7) if bit == l1 else 0
            left = [bit, *left[:-1]]

    def _by_contexts(self, bits: Bits, value: int, numbers: tuple[int, ...]) -> int:
        keys = list(enumerate(numbers))
        total = sum(self.cells.get(key, 0) for key in keys)
        probability = max(
            MIN_PROBABILITY, min(65536 - MIN_PROBABILITY, SQUASH[max(-2048, min(2047, total >> 4)) + 2048])
        )
        bit = bits.bit(value, probability)
        moves = (65536 * bit - probability) * RATE + self.left_over
        self.left_over = moves & 0xFFFF
        for key in keys:
            self.cells[key] = max(-32767, min(32767, self.cells.get(key, 0) + (moves >> 16)))
        return bit


def _columns(view: View) -> list[list[int]]:
    fired = [np.flatnonzero(view.fired[half]).tolist() for half in range(2)]
    return [fired[view.beams[0, row]] for row in range(ROWS)]


def _padded(cells: Around, count: int) -> Around:
    """With those beyond the ends, which are as the ends are."""
    for j in range(1, MARGIN + 1):
        cells[-j], cells[count - 1 + j] = cells[0], cells[count - 1]
    return cells


def _bounded(a: int, most: int) -> int:
    return max(-most, min(most, a))


def _moved(view: View, row: int, block: int, expected: int) -> tuple[int, int]:
    """Row, and directions on, where a place lay a turn ago."""
    cos, sin = cos_sin((block * BLOCK + BLOCK // 2) << 20)
    x, y, z = (_bounded(shift, MOST_MOVED) for shift in view.motion[9:])
    across, along = rounded30(x * sin + y * cos), rounded30(x * cos - y * sin)
    tilt = rounded30(view.motion[7] * sin + view.motion[2] * cos)
    nearness = 0 if expected == 0 else (1 << 40) // (32 * expected)
    turn = view.motion[3] + ((across * nearness) >> 10)
    down = rounded30(along * cos_sin(angle_of_table(int(view.beams[2, row])))[1]) - z
    rise = tilt + ((down * nearness) >> 10)
    elevation = [int(steps) for steps in view.beams[2]]
    target = elevation[row] + rounded30(_bounded(rise, MOST_TURNED) * 100_000_000)
    then = row
    while then + 1 < ROWS and abs(elevation[then + 1] - target) < abs(elevation[then] - target):
        then += 1
    while then > 0 and abs(elevation[then - 1] - target) < abs(elevation[then] - target):
        then -= 1
    return then, rounded30(_bounded(turn, MOST_TURNED) * 652)

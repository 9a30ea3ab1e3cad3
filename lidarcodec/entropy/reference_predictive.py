"""The predictive coder in pure Python: same bytes as native/src/predictive_*.hpp, for reading and for tests.

The turn is the encoder's choice and not part of the format: here it is given.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from lidarcodec.entropy import predictive_tables as tables
from lidarcodec.entropy.reference_intensity import ONE, WideReader, WideWriter, clamp16, closed_up, probability_of
from lidarcodec.entropy.reference_mask import ROWS, Layout, padded
from lidarcodec.entropy.reference_predictive_place import (
    LEAF_BITS,
    LIMITS,
    MARGIN,
    MAX_DIFFERENCE,
    Coder,
    Half,
    Model,
    Place,
    Surroundings,
    leaf_start,
)
from lidarcodec.errors import SectionError, TruncatedError

ALONE, EXPECTING = 1, 2
HEAD_BYTES: Final = 7
MAX_LEVEL: Final = 1000
MAX_RANGE: Final = 65535
RATES: Final = (720, 460, 320, 230)
OFFSET_RATE: Final = 655
DEPTH: Final = 3

Image = npt.NDArray[np.uint16]
Mask = npt.NDArray[np.uint8]


class RowCoder:
    """Codes rows of ranges, the two halves of a row in turns."""

    def __init__(self, model: Model, step: int, coders: tuple[Coder, Coder]) -> None:
        self._model, self._halves = model, [Half(coder) for coder in coders]
        self.start, self.first = 480 // step + 5, 2500 // step
        self._limit = (MAX_RANGE + MAX_LEVEL) // step + 1

    def code(self, about: Surroundings, cells: list[int], row: list[int], sizes: list[int]) -> None:
        """Code the ranges of a row in place. cells: its returns; sizes: takes what each differs by."""
        for half in self._halves:
            half.begin(self.start)
        middle = (len(cells) + 1) // 2
        for i in range(middle):
            turn = [(self._halves[0], cells[i])]
            if middle + i < len(cells):
                turn.append((self._halves[1], cells[middle + i]))
            places = [Place(half, about, k, self.first) for half, k in turn]
            walked = [self._walk(turn[h][0], place, row[place.cell]) for h, place in enumerate(places)]
            for (half, k), place, (leaf, learned) in zip(turn, places, walked, strict=True):
                self._learn(place, learned)
                distance = self._offset(half, place, leaf, row[k])
                row[k] = place.base + (-1 - distance if leaf < 8 else distance)
                if not 0 <= row[k] <= self._limit:
                    raise SectionError("a range beyond what the sensor can give")
                self._settle(half, about, place, row[k], leaf)
                sizes[k] = half.size1

    def _walk(self, half: Half, place: Place, value: int) -> tuple[int, list[tuple[int, int, int]]]:
        d = value - place.base
        away = -1 - d if d < 0 else d
        leaf = sum(away >= leaf_start(place.scale, n) for n in range(1, 8))
        wanted = 7 - leaf if d < 0 else 8 + leaf
        node, learned = 1, []
        slots = [self._model.slot(context) for context in place.contexts]
        for level in (3, 2, 1, 0):
            odds = slots[0][node]
            for slot in slots[1:]:
                odds = clamp16(odds + slot[node])
            p = probability_of(odds)
            bit = half.coder.bit(wanted >> level & 1, p)
            learned.append((node, p, bit))
            node = 2 * node + bit
        return node - 16, learned

    def _learn(self, place: Place, learned: list[tuple[int, int, int]]) -> None:
        for context in place.contexts:
            slot = self._model.slot(context)
            rate = RATES[sum(slot[0] >= seen for seen in (6, 24, 96))]
            for node, p, bit in learned:
                slot[node] = clamp16(slot[node] + (((ONE if bit else 0) - p) * rate + 0x8000 >> 16))
            slot[0] += slot[0] < 96

    def _decide(self, half: Half, a: tuple[object, ...], b: tuple[object, ...], start: int, bit: bool) -> int:
        offsets = self._model.offsets
        p = probability_of(clamp16(offsets.get(a, 0) + offsets.get(b, 0) + start))
        came = half.coder.bit(int(bit), p)
        by = ((ONE if came else 0) - p) * OFFSET_RATE + 0x8000 >> 16
        for cell in (a, b):
            offsets[cell] = clamp16(offsets.get(cell, 0) + by)
        return came

    def _offset(self, half: Half, place: Place, came: int, value: int) -> int:
        down, d = came < 8, value - place.base
        leaf, away = (7 - came if down else came - 8), (-1 - d if d < 0 else d)
        begin, scale = leaf_start(place.scale, leaf), place.scale
        left = LEAF_BITS[scale][leaf] if leaf < 7 else tables.beyond_bits(scale)
        near = [-1 - (x - place.base) if down else x - place.base for x in place.near]
        octave = 0
        while leaf == 7:
            if octave >= 16 or begin > self._limit:
                raise SectionError("a range beyond what the sensor can give")
            end = begin + (1 << left)
            here, beyond = [begin <= x < end for x in near], [end <= x for x in near]
            who = (here[0], here[1], here[2], here[3], beyond[0], beyond[1], beyond[3])
            if not self._decide(half, ("more", octave, who), ("more", octave, scale), 2730, away >= end):
                break
            begin, left, octave = end, left + 1, octave + 1
        for depth in range(min(left, DEPTH)):
            left -= 1
            middle = begin + (1 << left)
            says: tuple[bool, bool] | None = None
            for i, x in enumerate(near):
                if begin <= x < middle + (1 << left):
                    says = (x >= middle, i == 0)
                    break
            side = (leaf, down if leaf < 7 else None)
            if self._decide(half, ("near", says, depth, side), ("leaf", scale, leaf, depth), 0, away >= middle):
                begin = middle
        return begin + half.coder.plain(away - begin, left)

    def _settle(self, half: Half, about: Surroundings, place: Place, value: int, leaf: int) -> None:
        size = min(abs(value - place.base) << 4, MAX_DIFFERENCE)
        half.size2, half.size1 = (half.size2 + half.size1) // 2, size
        apart = size - half.mean
        half.mean += apart // 8 if apart >= 0 else -(-apart // 8)
        half.leaves = (leaf, half.leaves[0])
        above = about.above[place.cell + MARGIN] if about.above else place.base
        apart = (value - above) * 16 - half.level
        if not half.last or abs(apart) > 4 * LIMITS[place.scale][5]:
            half.level += apart
        else:
            half.level += apart * 11 // 32 if apart >= 0 else -(-apart * 11 // 32)
        if about.expected and about.known[place.cell + MARGIN]:
            by = (value - about.expected[place.cell + MARGIN]) * 16 - half.bias
            missed = min(abs(by >> 4) << 4, MAX_DIFFERENCE) - half.miss
            half.miss += missed // 4 if missed >= 0 else -(-missed // 4)
            if abs(by) <= 4 * LIMITS[place.scale][5]:
                half.bias += by // 4 if by >= 0 else -(-by // 4)
        half.last = [value, *half.last[:4]] if half.last else [value] * 5


def filled(values: list[int], cells: list[int]) -> list[int]:
    """A row in which no returns have what is to their left, those at the start what the first return has."""
    out, at = [], 0
    for k in range(len(values)):
        if at + 1 < len(cells) and cells[at + 1] <= k:
            at += 1
        out.append(values[cells[at]])
    return out


def foreseen(expected: list[int], instead: list[int]) -> list[int]:
    """Expected ranges of a row, -1 where nothing is known: that to the left there, then the first, else `instead`."""
    first = next((x for x in expected if x >= 0), None)
    if first is None:
        return instead
    return [first := x if x >= 0 else first for x in expected]


def code_rows(
    layout: Layout,
    mask: list[list[int]],
    rows: list[list[int]],
    turn: int,
    coder: RowCoder,
    expected: list[list[int]] | None = None,
) -> None:
    """Code all rows of ranges in place, in cells. mask: closed-up rows; expected: -1 where nothing is."""
    ranges: list[list[int]] = []
    sizes: list[list[int]] = []
    seen_ranges: list[list[int]] = []
    for row in range(ROWS):
        n = len(rows[row])
        none = [1] * (n + 2 * MARGIN)
        above = layout.above(ranges, row - 1, row, turn) if row >= 1 else []
        of_above = layout.above(sizes, row - 1, row, turn) if row >= 1 else [coder.start] * (n + 2 * MARGIN)
        about = Surroundings(
            padded(mask[row]) if n else none,
            layout.above(mask, row - 1, row, turn) if row >= 1 else none,
            layout.above(mask, row + 1, row, turn) if row + 1 < ROWS else none,
            above,
            layout.above(ranges, row - 2, row, turn) if row >= 2 else [],
            of_above,
        )
        seen = slice(MARGIN, MARGIN + n)
        if expected is not None:
            seen_ranges.append(foreseen(expected[row], above[seen] if above else [coder.first] * n))
        if expected is not None and n:
            about.expected, about.known = padded(seen_ranges[row]), padded([int(x >= 0) for x in expected[row]])
            about.expected_above = layout.above(seen_ranges, row - 1, row, turn) if row >= 1 else []
        cells = [k for k in range(n) if mask[row][k]]
        taken = [0] * n
        coder.code(about, cells, rows[row], taken)
        ranges.append(filled(rows[row], cells) if cells else above[seen] if above else [coder.first] * n)
        sizes.append(filled(taken, cells) if cells else of_above[seen])


def expected_cells(expected: Image | None, layout: Layout, step: int, levels: list[int]) -> list[list[int]] | None:
    """Closed-up rows of expected ranges in cells, -1 for 0."""
    if expected is None:
        return None
    rows = closed_up(expected, layout)
    return [[(x + levels[row] + step // 2) // step if x else -1 for x in rows[row]] for row in range(ROWS)]


def encode(
    values: Image,
    returns: Mask,
    layout: Layout,
    step: int,
    levels: list[int],
    turn: int,
    model: Model,
    expected: Image | None = None,
) -> bytes:
    """Bytes of (64, W) ranges. returns: (64, W) uint8 of 0 and 1; model: goes on from what it learned before."""
    mask, rows = closed_up(returns, layout), closed_up(values, layout)
    if sum(map(sum, mask)) != int(returns.sum()):
        raise SectionError("a mask is set in a block that did not fire")
    if not returns.any():
        return b""
    cells = [[(x + levels[row] + step // 2) // step for x in rows[row]] for row in range(ROWS)]
    coders = WideWriter(), WideWriter()
    seen = expected_cells(expected, layout, step, levels)
    code_rows(layout, mask, cells, turn, RowCoder(model, step, coders), seen)
    first, second = (coder.finish() for coder in coders)
    sizes = [(ALONE if expected is None else EXPECTING, 1), (turn, 2), (len(first), 4)]
    return b"".join(value.to_bytes(size, "little") for value, size in sizes) + first + second


def decode(
    data: bytes,
    returns: Mask,
    layout: Layout,
    step: int,
    levels: list[int],
    model: Model,
    expected: Image | None = None,
) -> Image:
    """(64, W) uint16. Raises SectionError or TruncatedError."""
    image, mask = np.zeros((ROWS, layout.width), np.uint16), closed_up(returns, layout)
    if not returns.any():
        if data:
            raise SectionError("ranges where there are no returns")
        return image
    if len(data) < HEAD_BYTES:
        raise TruncatedError("ranges end within their header", len(data))
    if data[0] != (ALONE if expected is None else EXPECTING):
        raise SectionError("ranges of an unknown kind")
    turn, first = int.from_bytes(data[1:3], "little"), int.from_bytes(data[3:7], "little")
    if HEAD_BYTES + first > len(data):
        raise TruncatedError("ranges end before their streams do", len(data))
    coders = WideReader(data[HEAD_BYTES : HEAD_BYTES + first]), WideReader(data[HEAD_BYTES + first :])
    rows = [[0] * len(row) for row in mask]
    seen = expected_cells(expected, layout, step, levels)
    code_rows(layout, mask, rows, turn, RowCoder(model, step, coders), seen)
    for coder in coders:
        coder.finish()
    for row in range(ROWS):
        columns = np.array(layout.columns[layout.half[row]], np.intp)
        came = np.clip(np.array(rows[row], np.int64) * step - levels[row], 1, MAX_RANGE)
        image[row, columns] = came * np.array(mask[row], np.int64)
    return image


__all__ = ["Model", "decode", "encode"]

"""The predictive coder in pure Python: same bytes as native/src/predictive/*.hpp, for reading and for tests.

The turn is the encoder's choice and not part of the format: here it is given. Of free ranges each gets the nearest cell
here, while the native encoder takes what costs less: its bytes are others, and both are decoded by either.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from lidarcodec.errors import SectionError, TruncatedError
from tests.reference.intensity import ONE, clamp16, closed_up, probability_of
from tests.reference.mask import ROWS, Layout
from tests.reference.predictive_place import (
    FIRINGS,
    LEAF_BITS,
    LIMITS,
    MARGIN,
    MAX_DIFFERENCE,
    Model,
    Place,
    State,
    Surroundings,
    leaf_start,
    nearer,
)
from tests.reference.predictive_rows import Rows, Work, code_frame, code_slab
from tests.reference.wide_coder import WideReader, WideWriter

EXPECTED, SLAB, QUICK, FREE, HALVES = 1, 2, 8, 16, 32
"""Bits of a kind; 4 is for ranges coded with a network, which this coder has none of."""
FRAME_PARTS, SLAB_PARTS = 4, 2
SIZES_AT: Final = 4
"""Where in the head sizes of streams stand."""
MAX_LEVEL: Final = 1000
MAX_RANGE: Final = 65535
RATES: Final = (720, 460, 320, 230)
OFFSET_RATE: Final = 655
DEPTHS: Final = (4, 1, 1, 1, 2, 2, 2, 3)
"""How many bits of an offset learn, by leaf."""

Image = npt.NDArray[np.uint16]
Mask = npt.NDArray[np.uint8]
Coder = WideWriter | WideReader


class Given(NamedTuple):
    """What both ends know of a frame, or of a slab with the columns before it: `known` of them; None: a frame.

    firing: that of the first column behind those that are known, modulo 24; quick: with fewer contexts and other
    leaves; free: cells are counted from the last range; halves: upper and lower rows have models of their own.
    `decode` does as the bytes say of all four
    """

    layout: Layout
    step: int
    levels: list[int]
    expected: Image | None = None
    known: int | None = None
    firing: int = 0
    quick: bool = False
    free: bool = False
    halves: bool = False

    @property
    def kind(self) -> int:
        """The first byte."""
        bits = {EXPECTED: self.expected is not None, SLAB: self.known is not None, QUICK: self.quick, FREE: self.free}
        bits[HALVES] = self.halves
        return sum(bit for bit, is_set in bits.items() if is_set)

    def sixteenths(self, value: int, row: int) -> int:
        """A range in sixteenths of a cell: of whole cells, or as it is."""
        levelled = value + self.levels[row]
        if self.free:
            return (16 * levelled + self.step // 2) // self.step
        return (levelled + self.step // 2) // self.step * 16

    @property
    def parts(self) -> int:
        """Streams of returns: those of rows that are coded together, for each half."""
        return SLAB_PARTS if self.known is not None else 2 * FRAME_PARTS if self.halves else FRAME_PARTS

    @property
    def head_bytes(self) -> int:
        """Kind, turn, firing, size of each stream but the last; of a slab the known columns."""
        return SIZES_AT + 4 * (self.parts - 1) + (self.known is not None)


class Parts:
    """Codes rows of ranges, the quarters of a row or two rows in turns, each with a coder of its own."""

    def __init__(self, model: Model, step: int, coders: list[Coder], frame: Given) -> None:
        self._model, self._coders, self._quick = model, coders, frame.quick
        self._free, self._step, self._half = frame.free, step, 8 if frame.free else 0
        self._nearer = nearer(step) if frame.free else 0
        model.begin(quick=frame.quick)
        self.start, self.first = 480 // step + 5, 2500 // step * 16
        self._limit = (MAX_RANGE + MAX_LEVEL) // step + 1

    def code(self, work: Work) -> None:
        """Code a row."""
        quarter = -(-len(work.cells) // FRAME_PARTS)
        parts = [work._replace(cells=work.cells[p * quarter : (p + 1) * quarter]) for p in range(FRAME_PARTS)]
        self.code_in_turns(parts, [State(self.start) for _ in parts])

    def code_in_turns(self, works: list[Work], states: list[State]) -> None:
        """Code two rows, or the quarters of one: a return of each together, one by one where not all have one."""
        for i in range(max(len(work.cells) for work in works)):
            now = [p for p in range(len(works)) if i < len(works[p].cells)]
            for together in [now] if len(now) == len(works) else [[p] for p in now]:
                self._code_together(together, i, works, states)

    def _code_together(self, now: list[int], i: int, works: list[Work], states: list[State]) -> None:
        kind = {"quick": self._quick, "free": self._free}
        places = {p: Place(states[p], works[p].about, works[p].cells[i], self.first, **kind) for p in now}
        wanted = {p: self._number(places[p].base, works[p].row[places[p].cell]) for p in now}
        walked = {p: self._walk(self._coders[p], places[p], wanted[p]) for p in now}
        for p in now:
            place, (leaf, learned), row = places[p], walked[p], works[p].row
            self._learn(place, learned)
            distance = self._offset(self._coders[p], place, leaf, wanted[p])
            number = -1 - distance if leaf < 8 else distance
            value = row[place.cell] = self._middle(place.base, number)
            if not -2 * self._half <= value <= 16 * self._limit + 2 * self._half:
                raise SectionError("a range beyond what the sensor can give")
            self._settle(states[p], works[p].about, place, value, leaf)
            works[p].sizes[place.cell] = states[p].size1

    def _middle(self, base: int, number: int) -> int:
        """Where a cell lies."""
        return base + 16 * number - (self._nearer if number > 0 else -self._nearer if number < 0 else 0)

    def _number(self, base: int, value: int) -> int:
        """The cell of a range: of a free one the nearest, given in range steps with the level of its row."""
        if not self._free:
            return (value - base) // 16

        def off(number: int) -> int:
            return value - (self._middle(base, number) * self._step + 8 >> 4)

        return min(
            ((value - (base * self._step >> 4)) // self._step + n for n in range(-1, 4)), key=lambda n: abs(off(n))
        )

    def _walk(self, coder: Coder, place: Place, d: int) -> tuple[int, list[tuple[int, int, int]]]:
        away = -1 - d if d < 0 else d
        leaf = sum(away >= leaf_start(place.scale, n, quick=self._quick) for n in range(1, 8))
        wanted = 7 - leaf if d < 0 else 8 + leaf
        node, learned = 1, []
        slots = [self._model.slot(context) for context in place.contexts]
        for level in (3, 2, 1, 0):
            odds = slots[0][node]
            for slot in slots[1:]:
                odds = clamp16(odds + slot[node])
            p = probability_of(odds)
            bit = coder.bit(wanted >> level & 1, p)
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

    def _decide(self, coder: Coder, a: tuple[object, ...], b: tuple[object, ...], start: int, bit: bool) -> int:
        offsets = self._model.offsets
        p = probability_of(clamp16(offsets.get(a, 0) + offsets.get(b, 0) + start))
        came = coder.bit(int(bit), p)
        by = ((ONE if came else 0) - p) * OFFSET_RATE + 0x8000 >> 16
        for cell in (a, b):
            offsets[cell] = clamp16(offsets.get(cell, 0) + by)
        return came

    def _offset(self, coder: Coder, place: Place, came: int, d: int) -> int:
        down = came < 8
        leaf, away = (7 - came if down else came - 8), (-1 - d if d < 0 else d)
        begin, scale = leaf_start(place.scale, leaf, quick=self._quick), place.scale
        left = LEAF_BITS[self._quick][scale][leaf]
        if self._quick and leaf < 7:
            return begin + coder.plain(away - begin, left)
        near = [x - place.base + self._half >> 4 for x in place.near]
        near = [-1 - x if down else x for x in near]
        octave = 0
        while leaf == 7:
            if octave >= 17 or begin > 2 * self._limit:
                raise SectionError("a range beyond what the sensor can give")
            end = begin + (1 << left)
            here, beyond = [begin <= x < end for x in near], [end <= x for x in near]
            who = (here[0], here[1], here[2], here[3], beyond[0], beyond[1], beyond[3])
            if not self._decide(coder, ("more", octave, who), ("more", octave, scale), 2730, away >= end):
                break
            begin, left, octave = end, left + 1, octave + 1
        for depth in range(min(left, DEPTHS[leaf])):
            left -= 1
            middle = begin + (1 << left)
            says: tuple[bool, bool] | None = None
            for i, x in enumerate(near):
                if begin <= x < middle + (1 << left):
                    says = (x >= middle, i == 0)
                    break
            side = (leaf, down if leaf < 7 else None)
            if self._decide(coder, ("near", says, depth, side), ("leaf", scale, leaf, depth), 0, away >= middle):
                begin = middle
        return begin + coder.plain(away - begin, left)

    def _settle(self, part: State, about: Surroundings, place: Place, value: int, leaf: int) -> None:
        size = min(abs(value - place.base), MAX_DIFFERENCE)
        part.size2, part.size1 = (part.size2 + part.size1) // 2, size
        apart = size - part.mean
        part.mean += apart // 8 if apart >= 0 else -(-apart // 8)
        part.leaves = (leaf, part.leaves[0])
        apart = value - place.above - part.level
        if not part.last or abs(apart) > 4 * LIMITS[place.scale][5]:
            part.level += apart
        else:
            part.level += apart * 11 // 32 if apart >= 0 else -(-apart * 11 // 32)
        if about.expected and about.known[place.cell + MARGIN]:
            by = value - about.expected[place.cell + MARGIN] - part.bias
            missed = min(abs(by >> 4) << 4, MAX_DIFFERENCE) - part.miss
            part.miss += missed // 4 if missed >= 0 else -(-missed // 4)
            if abs(by) <= 4 * LIMITS[place.scale][5]:
                part.bias += by // 4 if by >= 0 else -(-by // 4)
        part.last = [value, *part.last[:4]] if part.last else [value] * 5


def expected_cells(frame: Given) -> list[list[int]] | None:
    """Closed-up rows of expected ranges in sixteenths of a cell, -1 for 0."""
    if frame.expected is None:
        return None
    rows = closed_up(frame.expected, frame.layout)
    return [[frame.sixteenths(x, row) if x else -1 for x in rows[row]] for row in range(ROWS)]


def _rows(values: list[list[int]], returns: Mask, frame: Given, turn: int) -> Rows:
    seen = expected_cells(frame)
    past = frame.known or 0
    firing = (frame.firing - past) % FIRINGS
    return Rows(frame.layout, closed_up(returns, frame.layout), values, turn, seen, past, firing)


def _code(rows: Rows, frame: Given, model: Model, coders: list[Coder]) -> None:
    model.divide(halves=frame.halves)
    if frame.known is not None:
        code_slab(rows, Parts(model, frame.step, coders, frame), model, frame.step, free=frame.free)
    elif model.lower is None:
        code_frame(rows, Parts(model, frame.step, coders, frame), range(ROWS))
    else:
        upper, lower = coders[:FRAME_PARTS], coders[FRAME_PARTS:]
        code_frame(rows, Parts(model, frame.step, upper, frame), range(ROWS // 2))
        code_frame(rows, Parts(model.lower, frame.step, lower, frame), range(ROWS // 2, ROWS))


def encode(values: Image, returns: Mask, frame: Given, turn: int, model: Model) -> bytes:
    """Bytes of (64, W) ranges. returns: (64, W) uint8 of 0 and 1; model: goes on from what it learned before."""
    layout = frame.layout
    mask, rows = closed_up(returns, layout), closed_up(values, layout)
    if sum(map(sum, mask)) != int(returns.sum()):
        raise SectionError("a mask is set in a block that did not fire")
    if not returns[:, frame.known or 0 :].any():
        return b""
    cells = [[frame.sixteenths(x, row) for x in rows[row]] for row in range(ROWS)]
    if frame.free:  # those that are to be coded are chosen one by one
        for row in range(ROWS):
            columns = layout.columns[layout.half[row]]
            cells[row] = [
                x + frame.levels[row] if columns[k] >= (frame.known or 0) else cells[row][k]
                for k, x in enumerate(rows[row])
            ]
    coders = [WideWriter() for _ in range(frame.parts)]
    _code(_rows(cells, returns, frame, turn), frame, model, list(coders))
    streams = [coder.finish() for coder in coders]
    sizes = [(frame.kind, 1), (turn, 2), (frame.firing, 1)]
    sizes += [(len(stream), 4) for stream in streams[:-1]]
    sizes += [] if frame.known is None else [(frame.known, 1)]
    return b"".join(value.to_bytes(size, "little") for value, size in sizes) + b"".join(streams)


def decode(data: bytes, returns: Mask, frame: Given, model: Model, before: Image | None = None) -> Image:
    """(64, W) uint16. before: (64, W), ranges of the known columns. Raises SectionError or TruncatedError."""
    layout, step, known = frame.layout, frame.step, frame.known or 0
    image, mask = np.zeros((ROWS, layout.width), np.uint16), closed_up(returns, layout)
    if before is not None:
        image[:, :known] = before[:, :known]
    if not returns[:, known:].any():
        if data:
            raise SectionError("ranges where there are no returns")
        return image
    if not data:
        raise TruncatedError("ranges end within their header", 0)
    halves = bool(data[0] & HALVES) and frame.known is None
    frame = frame._replace(quick=bool(data[0] & QUICK), free=bool(data[0] & FREE) and step > 1, halves=halves)
    head = frame.head_bytes
    if len(data) < head:
        raise TruncatedError("ranges end within their header", len(data))
    if data[0] != frame.kind or (frame.known is not None and data[head - 1] != frame.known):
        raise SectionError("ranges of an unknown kind")
    turn, coders, at = int.from_bytes(data[1:3], "little"), [], head
    frame = frame._replace(firing=data[3])
    if data[3] >= FIRINGS:
        raise SectionError("the count of firings goes beyond its period")
    for part in range(frame.parts):
        first = SIZES_AT + 4 * part
        size = int.from_bytes(data[first : first + 4], "little") if part + 1 < frame.parts else len(data) - at
        if at + size > len(data):
            raise TruncatedError("ranges end before their streams do", len(data))
        coders.append(WideReader(data[at : at + size]))
        at += size
    rows = [[frame.sixteenths(x, row) for x in cells] for row, cells in enumerate(closed_up(image, layout))]
    _code(_rows(rows, returns, frame, turn), frame, model, list(coders))
    for coder in coders:
        coder.finish()
    for row in range(ROWS):
        columns = np.array(layout.columns[layout.half[row]], np.intp)
        steps = np.array(rows[row], np.int64) * step + 8 >> 4
        came = np.clip(steps - frame.levels[row], 1, MAX_RANGE) * np.array(mask[row], np.int64)
        new = columns >= known
        image[row, columns[new]] = came[new]
    return image


__all__ = ["Given", "Model", "decode", "encode"]

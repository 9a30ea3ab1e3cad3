"""Rows of the predictive coder in pure Python: what is around each, and in which order they come.

Same as native/src/predictive/stage.hpp and predictive/coder.cpp; `predictive` codes with it.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

from tests.reference.mask import ROWS, Layout, padded
from tests.reference.predictive_place import FIRINGS, MARGIN, MAX_DIFFERENCE, Model, State, Surroundings


class Rows(NamedTuple):
    """An image in sixteenths of a cell, rows closed up, of which the first `past` columns are known.

    mask: returns; values: ranges; expected: -1 where nothing is; firing: of column 0
    """

    layout: Layout
    mask: list[list[int]]
    values: list[list[int]]
    turn: int
    expected: list[list[int]] | None = None
    past: int = 0
    firing: int = 0


class Work(NamedTuple):
    """Returns of a row to be coded in place, with what is around; sizes takes what each differs by."""

    about: Surroundings
    cells: list[int]
    row: list[int]
    sizes: list[int]


class RowCoder(Protocol):
    """Codes the returns of a row, or of two."""

    start: int
    first: int

    def code(self, work: Work) -> None:
        """Code a row."""

    def code_in_turns(self, works: list[Work], states: list[State]) -> None:
        """Code two rows."""


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


class Stage:
    """The rows from `top` on, one after another, with what was coded above."""

    def __init__(self, rows: Rows, top: int, coder: RowCoder) -> None:
        self._rows, self._top, self._start, self._first = rows, top, coder.start, coder.first
        self._ranges: list[list[int]] = [[] for _ in range(top)]
        self._sizes: list[list[int]] = [[] for _ in range(top)]
        self._foreseen: list[list[int]] = [[] for _ in range(top)]

    def begin(self, row: int) -> Work:
        """What is to be coded of a row."""
        rows, layout, turn = self._rows, self._rows.layout, self._rows.turn
        n = len(rows.values[row])
        none = [1] * (n + 2 * MARGIN)
        below_top = row - self._top
        self._above = layout.above(self._ranges, row - 1, row, turn, 16) if below_top >= 1 else []
        self._above_sizes = (
            layout.above(self._sizes, row - 1, row, turn) if below_top >= 1 else [self._start] * (n + 2 * MARGIN)
        )
        about = Surroundings(
            padded(rows.mask[row]) if n else none,
            layout.above(rows.mask, row - 1, row, turn) if row >= 1 else none,
            layout.above(rows.mask, row + 1, row, turn) if row + 1 < ROWS else none,
            self._above,
            layout.above(self._ranges, row - 2, row, turn, 16) if below_top >= 2 else [],
            self._above_sizes,
        )
        if rows.expected is not None:
            self._expect(about, rows.expected[row], row)
        self._returns = [k for k in range(n) if rows.mask[row][k]]
        columns = layout.columns[layout.half[row]]
        about.firings = [(row, (rows.firing + column) % FIRINGS) for column in columns]
        known = [k for k in self._returns if columns[k] < rows.past]
        taken = [0] * n
        for i, k in enumerate(known):
            differs = abs(rows.values[row][k] - rows.values[row][known[i - 1]])
            taken[k] = min(differs, MAX_DIFFERENCE) if i else self._start
        self._work = Work(about, self._returns[len(known) :], rows.values[row], taken)
        return self._work

    def end(self) -> None:
        """Take note of the row, which has been coded."""
        n = len(self._work.row)
        seen = slice(MARGIN, MARGIN + n)
        if self._returns:
            self._ranges.append(filled(self._work.row, self._returns))
            self._sizes.append(filled(self._work.sizes, self._returns))
        else:
            self._ranges.append(self._above[seen] if self._above else [self._first] * n)
            self._sizes.append(self._above_sizes[seen])

    def _expect(self, about: Surroundings, expected: list[int], row: int) -> None:
        n = len(expected)
        instead = self._above[MARGIN : MARGIN + n] if self._above else [self._first] * n
        self._foreseen.append(foreseen(expected, instead))
        if n:
            about.expected, about.known = padded(self._foreseen[row]), padded([int(x >= 0) for x in expected])
            if row > self._top:
                about.expected_above = self._rows.layout.above(self._foreseen, row - 1, row, self._rows.turn, 16)


def code_frame(rows: Rows, coder: RowCoder, which: range) -> None:
    """Code rows of a whole frame in place, one after another."""
    stage = Stage(rows, which.start, coder)
    for row in which:
        coder.code(stage.begin(row))
        stage.end()


def code_slab(rows: Rows, coder: RowCoder, model: Model, step: int, *, free: bool) -> None:
    """Code a slab in place: rows of the upper and the lower half in turns, each from where the last slab left it."""
    if not model.states or not rows.past:
        model.states = [State(coder.start) for _ in range(ROWS)]
    elif (model.step, model.free) != (step, free):
        for state in model.states:
            state.rescale(model.step, step, free=free)
    model.step, model.free = step, free
    stages = [Stage(rows, 0, coder), Stage(rows, ROWS // 2, coder)]
    for row in range(ROWS // 2):
        works = [stages[0].begin(row), stages[1].begin(row + ROWS // 2)]
        coder.code_in_turns(works, [model.states[row], model.states[row + ROWS // 2]])
        for stage in stages:
            stage.end()

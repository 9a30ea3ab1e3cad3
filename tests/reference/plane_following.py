"""One plane of frames that follow each other, after docs/wire-format-planes.md, "Frames that follow"."""

from __future__ import annotations

from typing import Final, NamedTuple

from tests.reference.intensity import ONE, clamp16, probability_of
from tests.reference.plane_cells import ATTRIBUTE, CONSTANT, Form, Ints, PlaneDecoder
from tests.reference.plane_rows import clamp, first_cell, ql, toward_zero

NOTHING: Final = -1


class Trace(NamedTuple):
    """What is known of a cell of the frame before."""

    mean: int = 0
    count: int = 0
    had: int = 0
    equalled: int = 0


class FollowingDecoder(PlaneDecoder):
    """A plane that looks at the frame before. learned: its decoder in the frame before."""

    PREDICTIONS = 8
    KEPT = ("cells", "spread", "bias", "proportion", "nearer", "far", "limit_far", "weights", "rows_done")

    def __init__(
        self, form: Form, width: int, way: int, constant: int, most: int, learned: FollowingDecoder | None
    ) -> None:
        super().__init__(form, width, way, constant, most, quick=False)
        self.weights: dict[tuple[object, ...], int] = {}
        self.rows_done = 0
        if learned is not None:
            for name in self.KEPT:
                setattr(self, name, getattr(learned, name))
        self.was, self.traces = [NOTHING] * width, [Trace()] * width
        self.kin: PlaneDecoder | None = None

    def start_row(self, row: int) -> None:
        """Go on to a row."""
        super().start_row(row)
        if self.way != CONSTANT:
            self.rows_done += 1
            self.rate = 60 + 128_000 // (self.rows_done + 512) + 1500 // self.rows_done

    def seen(self, x: int) -> tuple[int, Trace]:
        """What the frame before has at a column."""
        x = clamp(x, 0, len(self.was) - 1)
        return self.was[x], self.traces[x]

    def taken(self, x: int, n: int, value: int) -> Trace:
        """What becomes of the trace of a cell."""
        was, (mean, count, had, equalled) = self.was[x], self.traces[x]
        has = int(self.form.role == ATTRIBUTE or n > 0)
        if has and was != NOTHING and abs(n - was) <= 3 << self.scale[x]:
            count = min(count + 1, 6)
            mean += toward_zero(8 * value - mean, count + 1)
        elif has:
            mean, count = 8 * value, 0
        return Trace(mean, count, (2 * had + has) % 256, (2 * equalled + self.q.rows[0][x]) % 256)

    def flags(self, name: str, x: int, around: int) -> list[tuple[object, ...]]:
        """Further contexts of a decision by odds."""
        left, here, right = (
            trace.had if name == "h" else trace.equalled for _, trace in (self.seen(x + i) for i in (-1, 0, 1))
        )
        first = (name, 8, here % 16, around & 5, left & 1, right & 1)
        return [first, (name, 9, here, around & 1) if name == "h" else (name, 9, here)]

    def spread_way(self, steep: int, guess: int) -> int:
        """Second place of a spread."""
        if self.form.role != ATTRIBUTE or self.most <= 255:
            return super().spread_way(steep, guess)
        return min(15, ql(clamp(guess, 0, 8 * self.most)) // 4)

    def more_predictions(self, x: int, p: Ints) -> Ints:
        """Eight predictions."""
        was, left_was = self.seen(x)[0], self.seen(x - 1)[0]
        average = self.average(x)
        six = was if was != NOTHING else average
        both = NOTHING not in (was, left_was)
        seven = self.v.at(self.row, x, -1, 0) + was - left_was if both else six
        return [*p, six, self.in_proportion(x, average, seven)]

    def in_proportion(self, x: int, average: int, otherwise: int) -> int:
        """What the cell would be if it were to its neighbours as that of K is to those there."""
        if self.form.role != ATTRIBUTE or self.kin is None:
            return otherwise
        v, row = self.kin.v, self.row
        around = 2 * v.at(row, x, -1, 0) + 2 * v.at(row, x, 0, 1) + v.at(row, x, 1, 1) + v.at(row, x, -1, 1)
        around += v.at(row, x, -2, 0) + v.at(row, x, 0, 2)
        if row == 0:
            around = 8 * v.at(row, x, -1, 0)
        return min(8 * average * v.at(row, x, 0, 0) // around, self.most) if around >= 32 else otherwise

    def average(self, x: int) -> int:
        """The mean of the neighbours."""
        left, above, right, corner, second, higher = (
            self.v.at(self.row, x, i, up) for i, up in ((-1, 0), (0, 1), (1, 1), (-1, 1), (-2, 0), (0, 2))
        )
        return toward_zero(2 * left + 2 * above + right + corner + second + higher + 4, 8)

    def leaf_of(
        self, x: int, contexts: list[tuple[object, ...]], about: tuple[int, int, int], p: Ints, of: PlaneDecoder
    ) -> int:
        """The leaf of a number."""
        (k, expected, calm), row, e = about, self.row, self.errors[6]

        def d(y: int) -> int:
            m = clamp((2 * (y - expected)) >> k, -32, 31)
            size = next(i for i, end in enumerate((0, 1, 2, 4, 8, 16, 32)) if abs(m) <= end)
            return size if m >= 0 else -size

        def past(y: int) -> int:
            return 13 if y == NOTHING else d(y) + 6

        was = self.was[x]
        total = 2 * e.at(row, x, -1, 0) + e.at(row, x, -2, 0) + sum(e.at(row, x, i, 1) for i in (-1, 0, 1))
        last: tuple[object, ...]
        if self.form.role == ATTRIBUTE:
            last = ("n10", past(was), self.away(x, of, 15, 14, 2))
        else:
            last = ("n10", d(self.same), min(15, calm // 4)) if self.same is not None else ("n10", row % 128)
        more: list[tuple[object, ...]] = [
            ("n7", past(was), past(p[7])),
            ("n8", past(was), min(15, ql(min(total, 65535) >> k) // 2)),
            ("n9", past(self.seen(x - 1)[0]), past(self.seen(x + 1)[0])),
            last,
        ]
        return self.weighed([*contexts, *more], k)

    def away(self, x: int, of: PlaneDecoder, none: int, most: int, by: int) -> int:
        """How far the range is from that of the frame before."""
        assert isinstance(of, FollowingDecoder)
        if of.was[x] == NOTHING:
            return none
        return min(most, ql(abs(of.v.at(self.row, x, 0, 0) - of.was[x])) // by)

    def weighed(self, contexts: list[tuple[object, ...]], k: int) -> int:
        """A leaf by weighed decisions."""
        node, learned = 1, {}
        for _ in range(4):
            y = 0
            for i, c in enumerate(contexts):
                weight = self.weights.get((k, i, node), 15_000)
                y = clamp16(y + (self.cells.get((*c, node), first_cell(c, node)) * weight >> 16))
            p = probability_of(clamp16(2 * clamp16(2 * y)))
            bit = self.stream.bit(0, p)
            learned[node] = ONE * bit - p
            node = 2 * node + bit
        for at, error in learned.items():
            for i, c in enumerate(contexts):
                cell, weight = self.cells.get((*c, at), first_cell(c, at)), self.weights.get((k, i, at), 15_000)
                self.weights[k, i, at] = clamp16(weight + (((error * cell >> 16) * 2000 + 32768) >> 16))
                self.cells[(*c, at)] = clamp16(cell + ((error * self.rate + 32768) >> 16))
        return node - 16

    def more_symbol_contexts(self, x: int, has: int, of: PlaneDecoder) -> list[tuple[object, ...]]:
        """Further contexts of a symbol."""
        z = 0 if self.was[x] == NOTHING else min(self.was[x], 255)
        return [("s8", has, z), ("s9", z >> 3, self.last[has] >> 3, self.away(x, of, 3, 2, 4))]

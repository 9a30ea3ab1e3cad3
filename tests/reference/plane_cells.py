"""One plane of `planes`, cell by cell."""

from __future__ import annotations

from collections import defaultdict
from typing import Final, NamedTuple

from tests.reference.intensity import ONE, clamp16, probability_of
from tests.reference.plane_proportion import Proportion
from tests.reference.plane_rows import Far, Row, clamp, first_cell, ql, toward_zero
from tests.reference.range_coder import BitModel
from tests.reference.wide_coder import WideReader

RANGE, SECOND, ATTRIBUTE = range(3)
CONSTANT, NUMBERS, SYMBOLS, SPARSE = range(4)
WEIGHTS: Final = (64, 42, 26, 15, 10, 6, 3, 2, 1, 0)
FIRST_BIN: Final = (0, -34, -18, -10, -6, -4, -2, -1, 0, 1, 2, 3, 5, 7, 11, 19)
LEAF_BITS: Final = (0, 4, 3, 2, 1, 1, 0, 0, 0, 0, 0, 1, 1, 2, 3, 0)

Ints = list[int]


class Form(NamedTuple):
    """A plane, as the decoder is told."""

    role: int
    bits: int
    of: int
    like: int


class PlaneDecoder:
    """One plane. `cell` gives its numbers in order."""

    PREDICTIONS = 6

    def __init__(self, form: Form, width: int, way: int, constant: int, most: int, *, quick: bool) -> None:
        self.form, self.way, self.constant, self.most, self.quick = form, way, constant, most, quick
        returned = form.role == ATTRIBUTE or constant > 0 or way != CONSTANT
        self.v, self.e, self.h, self.q = Row(width, 0), Row(width, 0), Row(width, 1), Row(width, 0)
        self.errors = [Row(width, 0) for _ in range(self.PREDICTIONS)]
        self.leaf, self.scale = [8] * width, [0] * width
        self.same: int | None = None
        if way == CONSTANT:
            self.v.rows, self.h.rows = [[constant] * width], [[int(returned)] * width]
            for kept in (self.v, self.e, self.h, self.q):
                kept.same = True
        self.cells: dict[tuple[object, ...], int] = {}
        self.spread: dict[tuple[int, int], int] = {}
        self.bias: dict[tuple[int, int], int] = defaultdict(int)
        self.proportion = Proportion()
        self.run = 0
        self.last, self.before = [0, 0], [0, 0]
        self.nearer = [BitModel(), BitModel()]
        self.far = [[Far(), Far()], [Far(), Far()]]
        self.limit_far = [Far(), Far()]

    def begin(self, stream: WideReader) -> None:
        """Read from this stream."""
        self.stream = stream

    def start_row(self, row: int) -> None:
        """Go on to a row."""
        self.row = row
        self.rate = 450 + 1500 // (row + 1)
        self.proportion.cells = 0
        if row and self.way != CONSTANT:
            for kept in (self.v, self.e, self.h, self.q, *self.errors):
                kept.start()

    def model(self, model: BitModel) -> int:
        """A bit by a bit model."""
        bit = self.stream.bit(0, model.probability() >> 1)
        model.update(bool(bit))
        return bit

    def odds(self, contexts: list[tuple[object, ...]], rate: int) -> int:
        """A decision by odds."""
        p = probability_of(clamp16(sum(self.cells.get(c, 0) for c in contexts)))
        bit = self.stream.bit(0, p)
        for c in contexts:
            self.cells[c] = clamp16(self.cells.get(c, 0) + (((ONE * bit - p) * rate + 32768) >> 16))
        return bit

    def tree(self, contexts: list[tuple[object, ...]], levels: int) -> int:
        """A leaf; a cell is named by its context and its node."""
        node, learned = 1, {}
        for _ in range(levels):
            x = 0
            for c in contexts:
                x = clamp16(x + self.cells.get((*c, node), first_cell(c, node)))
            p = probability_of(x)
            bit = self.stream.bit(0, p)
            learned[node] = ((ONE * bit - p) * self.rate + 32768) >> 16
            node = 2 * node + bit
        for at, by in learned.items():
            for c in contexts:
                self.cells[(*c, at)] = clamp16(self.cells.get((*c, at), first_cell(c, at)) + by)
        return node - (1 << levels)

    def plain(self, bits: int) -> int:
        """Plain bits."""
        value = 0
        while bits > 0:
            now = min(bits, 16)
            bits -= now
            value = value << now | self.stream.plain(0, now)
        return value

    def far_number(self, far: Far) -> int:
        """A number by FAR."""
        length = 0
        while length < 22 and self.model(far.longer[length]):
            length += 1
        if length == 0:
            return 0
        m, node, left = 1, 1, length - 1
        while left > 0 and node < 4:
            bit = self.model(far.high[length][node])
            node, m, left = 2 * node + bit, 2 * m + bit, left - 1
        return (m << left) + self.plain(left)

    def cell(self, x: int, of: PlaneDecoder, like: PlaneDecoder | None, mate: PlaneDecoder | None) -> int:
        """The number of a column."""
        if self.way == CONSTANT:
            return self.constant
        row, attribute = self.row, self.form.role == ATTRIBUTE
        has = of.h.at(row, x, 0, 0) if attribute else 1
        if self.way == SPARSE and self.runs(x):
            self.q.rows[0][x] = 1
            self.known(x, self.constant, has, None)
            return self.constant
        if self.way == SPARSE or like:
            same = self.constant
            if self.way != SPARSE:
                assert like
                same = like.v.at(row, x, 0, 0) if attribute or like.h.at(row, x, 0, 0) else 0
                self.same = same
            q, e = self.q, (like or of).e
            e0, e1 = e.at(row, x, 0, 0), e.at(row, x, -1, 0)
            around = q.at(row, x, -1, 0) + 2 * q.at(row, x, -2, 0) + 4 * q.at(row, x, 0, 1)
            around += 8 * q.at(row, x, -1, 1) + 16 * q.at(row, x, 1, 1) + 32 * (e0 > 2 * (e1 + 1))
            kind = of.q.at(row, x, 0, 0) + 2 * has if attribute else int(same > 0)
            size = min(ql(e0) // 2, 31)
            contexts = [("e", 0, around, kind), ("e", 1, kind, size), ("e", 2, around % 8, kind)]
            self.q.rows[0][x] = self.odds([*contexts, *self.flags("e", x, around)], 2500)
            if self.q.rows[0][x]:
                self.known(x, same, has, like)
                return same
        if not attribute and not self.has(x):
            self.known(x, 0, 0, like)
            return 0
        return self.number(x, has, of, mate)

    def runs(self, x: int) -> bool:
        """Whether the cell is of a run of the constant."""
        row, q = self.row, self.q
        if x == 0:
            self.run = 0
        above = [q.at(row, x, i, 1) for i in range(16)]
        if row and x % 16 == 0 and x + 16 <= q.width and q.at(row, x, -1, 0) and all(above):
            around = q.at(row, x, -2, 0) + 2 * q.at(row, x, -1, 1) + 4 * q.at(row, x, 16, 1)
            self.run = x + 16 * self.odds([("r", around)], 2500)
        return x < self.run

    def has(self, x: int) -> int:
        """Whether there is a return."""
        row, h, e = self.row, self.h, self.e
        places = ((-1, 0), (-2, 0), (0, 1), (-1, 1), (1, 1), (0, 2), (2, 1), (-3, 0))
        around = sum(h.at(row, x, i, up) << n for n, (i, up) in enumerate(places))
        size = min(ql(e.at(row, x, -1, 0) + self.activity(x) // 4) // 2, 31)
        far = min(ql(self.v.at(row, x, -1, 0) >> 4) // 2, 15)
        left = [("h", 0, around), ("h", 2, around % 16, size)]
        contexts = [*left, ("h", 1, row % 64, around % 8), ("h", 3, around % 32, far), *self.flags("h", x, around)]
        bit = self.odds(contexts, 1800)
        self.h.rows[0][x] = bit
        return bit

    def flags(self, _name: str, _x: int, _around: int) -> list[tuple[object, ...]]:
        """Further contexts of a decision by odds."""
        return []

    def spread_way(self, steep: int, _guess: int) -> int:
        """Second place of a spread."""
        return clamp(toward_zero(steep + 18, 2), 0, 15)

    def leaf_of(
        self, _x: int, contexts: list[tuple[object, ...]], _about: tuple[int, int, int], _p: Ints, _of: PlaneDecoder
    ) -> int:
        """The leaf of a number."""
        return self.tree([contexts[i] for i in ((0, 1, 6) if self.quick else range(7))], 4)

    def more_predictions(self, _x: int, p: Ints) -> Ints:
        """All predictions."""
        return p

    def more_symbol_contexts(self, _x: int, _has: int, _of: PlaneDecoder) -> list[tuple[object, ...]]:
        """Further contexts of a symbol."""
        return []

    def activity(self, x: int) -> int:
        """A."""
        return 2 * self.e.at(self.row, x, 0, 1) + self.e.at(self.row, x, 1, 1) + self.e.at(self.row, x, -1, 1)

    def known(self, x: int, n: int, has: int, like: PlaneDecoder | None) -> None:
        """Keep a number that needed no coding."""
        row, returned = self.row, self.form.role == ATTRIBUTE or n > 0
        self.leaf[x], self.scale[x] = 8, self.scale[x - 1] if x else 0
        for errors in self.errors:
            errors.rows[0][x] = errors.at(row, x, -1, 0)
        self.h.rows[0][x] = int(returned)
        if returned:
            self.last[has] = n
            self.v.rows[0][x] = n
            self.e.rows[0][x] = like.e.at(row, x, 0, 0) if like else 0
        else:
            self.e.rows[0][x] = self.e.at(row, x, -1, 0)
            self.v.rows[0][x] = like.v.at(row, x, 0, 0) if like else self.v.at(row, x, -1, 0)

    def number(self, x: int, has: int, of: PlaneDecoder, mate: PlaneDecoder | None) -> int:
        """The number of a cell that has one."""
        row, most, attribute = self.row, self.most, self.form.role == ATTRIBUTE
        places = ((0, 1), (-1, 0), (1, 1), (-1, 1), (-2, 0), (0, 2))
        near = [self.v.at(row, x, i, up) for i, up in places]
        above, left, right, corner = near[:4]
        p, turn = self.predictions(x, has, near, of, mate)
        least, guess = self.guess(x, p, left, above, corner, mate)
        bias = (min(63, least), turn)
        eighths = clamp(guess + (self.bias[bias] >> 8), 0, 8 * most)
        expected = (eighths + 4) >> 3
        calm = ql(2 * self.e.at(row, x, -1, 0) + self.e.at(row, x, -2, 0) + self.activity(x))
        steep = ql(abs(left - corner) + abs(above - corner) + abs(above - right)) - calm
        at = (min(127, calm), self.spread_way(steep, guess))
        a = min(at[0], 79)
        spread = self.spread.get(at, 8 + 4 * (a + 1 if a < 4 else (4 + a % 4) << (a // 4 - 1)))
        share = (spread * (3 if attribute else 2)) >> 8
        k = min(16, share.bit_length())
        start = expected - (1 << (k - 1) if k else 0)
        self.scale[x] = k

        if self.way == SYMBOLS:
            n = self.symbol(x, has, turn, expected, ql(spread), p[5], of, mate)
        else:
            contexts = self.contexts(
                x, (k, spread, share), (eighths, expected), (turn, has, calm), near, p[3], of, mate
            )
            leaf = self.leaf_of(x, contexts, (k, expected, calm), p, of)
            n = self.within(leaf, k, start, near) if 0 < leaf < 15 else self.beyond(leaf == 15, k, start, near)
        assert (0 if attribute else 1) <= n <= most
        bin_of = (n - start) >> k
        self.leaf[x] = 0 if bin_of < -34 else max(i for i in range(1, 16) if FIRST_BIN[i] <= bin_of)
        wrong = abs(n - expected)
        self.v.rows[0][x], self.e.rows[0][x], self.h.rows[0][x] = n, min(wrong, 1 << 18), 1
        for i, errors in enumerate(self.errors):
            errors.rows[0][x] = min(abs(n - p[i]), 32767)
        self.spread[at] = spread + toward_zero(min(16 * wrong, 8 * spread + 64) - spread, 16)
        moved = self.bias[bias] + 4 * clamp(8 * n - eighths, -(32 << k), 32 << k)
        self.bias[bias] = clamp(moved, -(1 << 20), 1 << 20)
        if mate:
            self.proportion.learn(n, mate.v.at(row, x, 0, 0))
        if attribute:
            self.before[has], self.last[has] = self.last[has], n
        return n

    def predictions(
        self, x: int, has: int, near: Ints, of: PlaneDecoder, mate: PlaneDecoder | None
    ) -> tuple[Ints, int]:
        """The predictions, and `turn`."""
        row, most, attribute = self.row, self.most, self.form.role == ATTRIBUTE
        above, left, right, corner, second, higher = near
        average = toward_zero(2 * left + 2 * above + right + corner + second + higher + 4, 8)
        p = [left, above, left + above - corner, right, 2 * left - second, average]
        turn = 2 * (above > left) + (right > above)
        if attribute:
            h = {(i, up): of.h.at(row, x, i, up) for i, up in ((-1, 0), (0, 1), (1, 1), (-1, 1))}
            turn = has + 2 * h[-1, 0] + 4 * h[0, 1]
            p[3] = average
            if mate:
                y = of.v.at(row, x, 0, 0) if has else 0
                p[3] = self.proportion.expect(mate.v.at(row, x, 0, 0), y, most)
            p[4] = toward_zero(2 * left + second + 1, 3) if h[-1, 0] == has else self.last[has]
            p[5] = self.last[has]
            for place, value in (((-1, 1), corner), ((1, 1), right), ((0, 1), toward_zero(above + higher, 2))):
                p[5] = value if h[place] == has else p[5]
        return self.more_predictions(x, p), turn

    def contexts(
        self,
        x: int,
        scale: tuple[int, int, int],
        guess: tuple[int, int],
        about: tuple[int, int, int],
        near: Ints,
        fit: int,
        of: PlaneDecoder,
        mate: PlaneDecoder | None,
    ) -> list[tuple[object, ...]]:
        """The seven contexts of a number."""
        row, most, attribute = self.row, self.most, self.form.role == ATTRIBUTE
        (k, spread, share), (eighths, expected), (turn, has, calm) = scale, guess, about
        above, left, right, corner, second, higher = near
        fine = min(3, spread >> 3) if k == 0 else (share << 16 >> (share.bit_length() + 13)) & 3

        def d(y: int) -> int:
            m = clamp((2 * (y - expected)) >> k, -32, 31)
            size = next(i for i, end in enumerate((0, 1, 2, 4, 8, 16, 32)) if abs(m) <= end)
            return size if m >= 0 else -size

        others: tuple[tuple[int, ...], tuple[int, ...]]
        if attribute:
            others = ((of.leaf[x], turn), (mate.leaf[x] if mate else 0, has))
            size = expected if most < 256 else ql(expected)
        else:
            h0 = tuple(self.h.at(row, x, i, up) for i, up in ((-1, 0), (-2, 0), (0, 1), (-1, 1), (1, 1)))
            others, size = (h0, (ql(expected),)), min(255, calm)
        two, three = (d(right), d(corner)), (d(second), d(higher))
        if mate:
            two = (d(fit), min(12, ql(mate.v.at(row, x, 0, 0)) // 2) - 6)
            three = (d(fit), min(12, k) - 6)
        return [
            ("n0", k, fine, eighths % 8 if k == 0 else 0),
            ("n1", d(above), d(left)),
            ("n2", *two),
            ("n3", *three),
            ("n4", *others[0]),
            ("n5", *others[1]),
            ("n6", size),
        ]

    def guess(self, x: int, p: Ints, left: int, above: int, corner: int, mate: PlaneDecoder | None) -> tuple[int, int]:
        """The least logarithm, and the expectation in eighths."""
        row = self.row
        if self.quick:
            a, b = (p[4], p[5]) if self.form.role == ATTRIBUTE else (left, above)
            return 0, 8 * (p[3] if mate else sorted((a, b, a + b - corner))[1])
        logs = []
        for errors in self.errors:
            e = errors.at(row, x, -1, 1) + errors.at(row, x, 0, 1) + errors.at(row, x, 1, 1)
            logs.append(ql(min(65535, 2 * errors.at(row, x, -1, 0) + errors.at(row, x, -2, 0) + e)))
        least = min(logs)
        weights, base = [WEIGHTS[min(9, log - least)] for log in logs], p[logs.index(least)]
        total = sum(weights)
        part = sum(w * clamp16(y - base) for w, y in zip(weights, p, strict=True))
        return least, 8 * base + ((part * ((2**24 + total // 2) // total)) >> 21)

    def within(self, leaf: int, k: int, start: int, near: Ints) -> int:
        """A number of leaf 1 to 14."""
        first, bits = start + FIRST_BIN[leaf] * (1 << k), LEAF_BITS[leaf] + k
        if LEAF_BITS[leaf] >= 2 and not self.quick:
            u = min(3, bits)
            bits -= u
            above, left, right = (clamp((y - first) >> bits, -1, 8) for y in near[:3])
            four = [("w0", above), ("w1", left), ("w2", right), ("w3", min(k, 9))]
            first += self.tree([(name, leaf, u, place) for name, place in four], u) << bits
        return first + self.plain(bits)

    def beyond(self, up: bool, k: int, start: int, near: Ints) -> int:
        """A number of leaf 0 or 15."""
        sign = 1 if up else -1
        limit = start + 19 * (1 << k) if up else start - 34 * (1 << k) - 1
        for y in near:
            if sign * y < sign * limit:
                continue
            nearer = self.model(self.nearer[up])
            m = self.far_number(self.far[up][nearer])
            return y - sign * (m + 1) if nearer else y + sign * m
        z = max(k - 1, 0)
        m = self.far_number(self.limit_far[up])
        return limit + sign * ((m << z) + self.plain(z))

    def symbol(
        self, x: int, has: int, turn: int, g: int, w: int, up: int, of: PlaneDecoder, mate: PlaneDecoder | None
    ) -> int:
        """A number of up to 8 bits by itself."""
        a, b = self.last[has], self.before[has]
        contexts: list[tuple[object, ...]] = [
            ("s0", g >> 2, min(3, w // 8)),
            ("s1", has, a),
            ("s2", has, up),
            ("s3", a >> 3, up >> 3, has),
            ("s4", a >> 3, b >> 3),
            ("s5", of.leaf[x], turn),
            ("s6", mate.leaf[x], g >> 3) if mate else ("s6", has),
            ("s7", g >> 3, min(31, w)),
        ][: 6 if self.quick else 8]
        contexts += self.more_symbol_contexts(x, has, of)
        high = self.tree([(*c, None) for c in contexts], 4)
        return 16 * high + self.tree([(*c, high) for c in contexts], 4)

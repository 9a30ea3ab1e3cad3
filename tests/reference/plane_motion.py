"""The frame before as a sensor that moved sees it, after docs/wire-format-planes.md, "Motion"."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final, NamedTuple

from tests.reference.plane_cells import Ints
from tests.reference.plane_rows import read_varint, toward_zero
from tests.reference.warp import INVERSE_CORDIC_GAIN, TURN, cos_sin, rounded30, to_polar

BEAMS, COLUMNS, MOTION = 1, 2, 4
NEAREST: Final = 512


class Columns(NamedTuple):
    """Where the columns of a frame look."""

    first: int
    at: Ints

    @property
    def step(self) -> int:
        """S."""
        return self.at[-1] // (len(self.at) - 1)


class Moved(NamedTuple):
    """What a cell sees: a cell of the frame before, row and column, and its moved mean."""

    source: tuple[int, int]
    mean: int


@dataclass
class View:
    """Where a sensor looks, as far as it is known; turn and shift: of the motion to this frame."""

    up: Ints = field(default_factory=list)
    aside: Ints = field(default_factory=list)
    columns: Columns | None = None
    before: Columns | None = None
    motion: tuple[Ints, Ints] | None = None

    def read(self, data: bytes, at: int, rows: int, width: int) -> int:
        """Reads the view of the next frame; where it ends."""
        marks, at = data[at], at + 1
        self.before, self.columns, self.motion = self.columns, None, None
        if marks & BEAMS:
            numbers, at = read_signed(data, at, 2 * rows)
            self.up, self.aside = numbers[::2], numbers[1::2]
        if marks & COLUMNS:
            first, at = read_varint(data, at)
            pieces, at = read_varint(data, at)
            angles = [0]
            for _ in range(pieces):
                count, at = read_varint(data, at)
                step, at = read_varint(data, at)
                angles += [angles[-1] + step * (i + 1) for i in range(count)]
            assert len(angles) == width
            self.columns = Columns(first, angles)
        if marks & MOTION:
            numbers, at = read_signed(data, at, 6)
            self.motion = numbers[:3], numbers[3:]
        return at

    def moved(self, means: list[Ints], most: int) -> dict[tuple[int, int], Moved]:
        """What each cell that sees something of the frame before sees. means: of a range plane."""
        assert self.motion is not None
        assert self.columns is not None
        assert self.before is not None
        return Mover(self.up, self.aside, self.before, self.columns).move(means, self.motion, most)


def read_signed(data: bytes, at: int, count: int) -> tuple[Ints, int]:
    """Signed varints, and where they end."""
    found = []
    for _ in range(count):
        number, at = read_varint(data, at)
        found.append(number >> 1 if number % 2 == 0 else -(number >> 1) - 1)
    return found, at


def rotation_of(h: Ints) -> list[Ints]:
    """R."""
    one, (x, y, z) = 1 << 18, h
    spin, square = ((0, -z, y), (z, 0, -x), (-y, x, 0)), x * x + y * y + z * z
    q, found = one * one + square, []
    for i in range(3):
        parts = [
            2 * (one * spin[i][j] + h[i] * h[j] - (square if i == j else 0)) + (q if i == j else 0) for j in range(3)
        ]
        found.append([((part << 24) + q // 2) // q for part in parts])
    return found


def slope(a: int | None, b: int | None, limit: int) -> int:
    """The change from one step to the next; None: not known."""
    if a is None and b is None:
        return 0
    if a is None or b is None:
        found = b if a is None else a
    elif abs(a - b) <= limit:
        found = toward_zero(a + b, 2)
    else:
        found = b if abs(b) < abs(a) else a
    assert found is not None
    return found if abs(found) <= 8 * limit else 0


@dataclass
class Cell:
    """What fell into a cell."""

    weight: int = 0
    sum: int = 0
    best: int = 0
    source: tuple[int, int] = (-1, -1)


class Mover:
    """Moves range planes."""

    def __init__(self, up: Ints, aside: Ints, before: Columns, now: Columns) -> None:
        self.rows, self.before, self.now = len(up), before, now
        self.up = [cos_sin(4096 * one % TURN) for one in up]
        self.aside, self.sides = [4096 * one for one in aside], [cos_sin(4096 * one % TURN) for one in aside]
        self.turned = [cos_sin((before.first + at) % TURN) for at in before.at]
        self.tan = tan = [(s << 24) // c for c, s in self.up]
        self.gap = [(1 << 40) // (tan[r] - tan[r + 1]) for r in range(self.rows - 1)]
        inner = [(1 << 41) // (tan[r - 1] - tan[r + 1]) for r in range(1, self.rows - 1)]
        self.gaps = [self.gap[0], *inner, self.gap[-1]]
        half = before.step // 2
        self.above = [0] + [(4096 * (aside[r] - aside[r - 1]) + half) // before.step for r in range(1, self.rows)]
        self.cells: dict[tuple[int, int], Cell] = {}

    def inverse(self, r: int, x: int) -> int:
        """u."""
        if not (0 <= r < self.rows and 0 <= x < len(self.before.at)):
            return 0
        h = rounded30(self.means[r][x] * self.up[r][0])
        return (1 << 38) // h if h >= NEAREST else 0

    def move(self, means: list[Ints], motion: tuple[Ints, Ints], most: int) -> dict[tuple[int, int], Moved]:
        """As of `View.moved`."""
        self.means, self.rotation, self.shift = means, rotation_of(motion[0]), motion[1]
        for r in range(self.rows):
            for x, at in enumerate(self.before.at):
                if self.inverse(r, x) > 0 and at > self.before.at[-1] - TURN:
                    self.move_cell(r, x)
        found = {}
        for (k, x), cell in self.cells.items():
            if cell.weight > 0:
                mean = min((((cell.weight << 38) // cell.sum) << 30) // self.up[k][0], most)
                found[k, x] = Moved(cell.source, mean)
        return found

    def move_cell(self, r: int, x: int) -> None:
        """Moves one cell."""
        u, m, ((c, s), (ca, sa), (cx, sx)) = (
            self.inverse(r, x),
            self.means[r][x],
            (self.up[r], self.sides[r], self.turned[x]),
        )
        h = rounded30(m * c)
        p, q = rounded30(h * ca), rounded30(h * sa)
        point = rounded30(p * cx - q * sx), rounded30(p * sx + q * cx), rounded30(m * s)
        x1, y1, z1 = (
            ((sum(part * of for part, of in zip(row, point, strict=True)) + (1 << 23)) >> 24) + shift
            for row, shift in zip(self.rotation, self.shift, strict=True)
        )
        length, angle = to_polar(x1, y1)
        d = rounded30(length * INVERSE_CORDIC_GAIN)
        if d < NEAREST:
            return
        above = self.inverse(r - 1, x + self.above[r]) if r > 0 else 0
        below = self.inverse(r + 1, x - self.above[r + 1]) if r + 1 < self.rows else 0
        left, right = self.inverse(r, x - 1), self.inverse(r, x + 1)
        rise = slope(
            (above - u) * self.gap[r - 1] >> 16 if above else None,
            (u - below) * self.gap[r] >> 16 if below else None,
            (u >> 5) * self.gaps[r] >> 16,
        )
        along = slope(u - left if left else None, right - u if right else None, u >> 5)
        self.place(((z1 << 24) // d, (1 << 38) // d, rise, along, angle, (r, x)))

    def place(self, point: tuple[int, int, int, int, int, tuple[int, int]]) -> None:
        """Puts a point between rows."""
        t, tan = point[0], self.tan
        n = sum(one >= t for one in tan)
        if n == 0:
            weights = {0: 256} if 2 * (t - tan[0]) < tan[0] - tan[1] else {}
        elif n == self.rows:
            weights = {n - 1: 256} if 2 * (tan[-1] - t) < tan[-2] - tan[-1] else {}
        else:
            part = (t - tan[n]) * self.gap[n - 1] >> 32
            weights = {n - 1: part, n: 256 - part}
        for row, weight in weights.items():
            if weight > 0:
                a = (point[4] - self.aside[row] - self.now.first) % TURN
                self.place_at(row, a, weight, point)
                if a + TURN <= self.now.at[-1]:
                    self.place_at(row, a + TURN, weight, point)

    def place_at(self, k: int, a: int, w: int, point: tuple[int, int, int, int, int, tuple[int, int]]) -> None:
        """Puts a point between columns."""
        (t, v, rise, along, _, source), at = point, self.now.at
        x = max(i for i, one in enumerate(at) if one <= a)
        following = x + 1 if x + 1 < len(at) else 0
        gap = (at[following] if following else TURN) - at[x]
        if not 0 < gap <= 3 * self.now.step:
            return
        part = (a - at[x]) * ((1 << 40) // gap) >> 32
        if part > 256:
            return
        risen = v + (rise * (self.tan[k] - t) >> 24)
        self.add((k, x), w * (256 - part) >> 8, risen - (along * part >> 8), v, source)
        self.add((k, following), w * part >> 8, risen + (along * (256 - part) >> 8), v, source)

    def add(self, at: tuple[int, int], weight: int, inverse: int, v: int, source: tuple[int, int]) -> None:
        """Adds to a cell."""
        if weight < 8 or 2 * inverse <= v or inverse >= 2 * v:
            return
        cell = self.cells.setdefault(at, Cell())
        if cell.weight >= 1 << 16:
            return
        off = inverse * cell.weight - cell.sum
        if cell.weight > 0 and 32 * abs(off) > cell.sum:
            if weight <= 2 * cell.weight and (off <= 0 or 2 * weight <= cell.weight):
                return
            cell = self.cells[at] = Cell()
        cell.weight += weight
        cell.sum += weight * inverse
        if weight > cell.best:
            cell.best, cell.source = weight, source

"""What planes keep of their rows and of numbers far off, for `planes`."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from tests.reference.range_coder import BitModel

PAGE: Final = Path(__file__).parents[2] / "docs/wire-format-planes.md"
FIRST_CELLS: Final = [
    [256 * int(number) for number in line.split()]
    for line in PAGE.read_text().partition("## First cells")[2].split("```\n")[1].splitlines()
]
FIRST_ODDS: Final = (0, 1826, 5499, -5665, 6104, 796, -3728, -3351, -4931, 2735, 2825, 2024, -3972, 1449, 58, -1768)


def clamp(x: int, low: int, high: int) -> int:
    """x, but within low and high."""
    return max(low, min(x, high))


def toward_zero(a: int, b: int) -> int:
    """a / b without its fraction."""
    return a // b if a >= 0 else -(-a // b)


def ql(x: int) -> int:
    """Logarithm in quarters of an octave."""
    below = (x + 4).bit_length() - 3
    return 4 * below + ((x + 4) >> below) - 4


def first_cell(context: tuple[object, ...], node: int) -> int:
    """What a cell begins with."""
    if context[0] == "n0":
        return FIRST_ODDS[node]
    if context[0] == "n1":
        _, above, left = context
        assert isinstance(above, int)
        assert isinstance(left, int)
        return FIRST_CELLS[13 * (above + 6) + left + 6][node - 1]
    if context[0] != "s0":
        return 0
    _, guess, _, high = context
    assert isinstance(guess, int)
    level = node.bit_length() - 1
    way = node - (1 << level)
    if high is not None:
        assert isinstance(high, int)
        way, level = (high << level) + way, level + 4
    half = 1 << (8 - level)
    return toward_zero(clamp(8 * guess + 4 - (2 * way + 1) * half, -half, half) * 21845, 256)


class Row:
    """What is kept of a plane's last rows: `here[-1]` to the left, `above(1)` above to the right."""

    def __init__(self, width: int, first: int) -> None:
        self.width, self.first, self.rows = width, first, [[first] * width]
        self.same = False  # whether all rows are one

    def start(self) -> None:
        """Go on to the next row."""
        self.rows.insert(0, [self.first] * self.width)
        del self.rows[3:]

    def at(self, row: int, x: int, i: int, up: int) -> int:
        """The value `up` rows above and i columns to the right."""
        if row == 0 and up:
            return self.at(row, x, -1, 0)
        if up == 2 and row == 1:
            up = 1
        x += i
        if self.same:
            return self.rows[0][x] if 0 <= x < self.width else self.first
        if up == 0:
            return self.rows[0][x] if x >= 0 else self.first if row == 0 else self.rows[1][0]
        return self.rows[up][clamp(x, 0, self.width - 1)]


class Far:
    """Numbers of any size."""

    def __init__(self) -> None:
        self.longer = [BitModel() for _ in range(22)]
        self.high = [[BitModel() for _ in range(4)] for _ in range(23)]


def read_varint(data: bytes, at: int) -> tuple[int, int]:
    """A varint, and where it ends."""
    value = shift = 0
    while True:
        byte, at = data[at], at + 1
        value |= (byte & 127) << shift
        shift += 7
        if byte < 128:
            return value, at

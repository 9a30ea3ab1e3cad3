"""The mask coder in pure Python: same bytes as native/src/mask/coder.cpp, for reading and for tests.

How rows lie to each other (`turn`) and to the earlier frame (`shift`) is the encoder's choice and not part of the
format: here it is given.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from lidarcodec.errors import SectionError, TruncatedError
from tests.reference.range_coder import BitModel, BitReader, Bits, BitWriter, Mixer

ROWS: Final = 64
TURN: Final = 628318531
"""Full turn, steps of 1e-8 rad."""
NONE, ALL, ALONE, WITH_EARLIER = range(4)
SURE: Final = 512
RUN_CLASS: Final = [0, 1, 2, 3, 4, 4, 5, 5, 5, 6, 6, 6, 6, 6, 6, 7]
PRIOR: Final = [10000, 24000, 42000, 61000]
"""Where a context starts, by 2 * left + above."""

Mask = npt.NDArray[np.uint8]


class Layout:
    """Of each half its fired columns, and how many columns of the other half fired before each."""

    def __init__(self, fired: Mask, half: Mask, rotation: npt.NDArray[np.int32]) -> None:
        self.width: int = fired.shape[1]
        self.half, self.rotation = [int(h) for h in half], [int(r) for r in rotation]
        self.columns = [[c for c in range(self.width) if fired[h, c]] for h in range(2)]
        self.across = [[sum(c < column for c in self.columns[1 - h]) for column in self.columns[h]] for h in range(2)]

    def cells(self, row: int) -> int:
        """Cells of a row."""
        return len(self.columns[self.half[row]])

    def shift(self, above: int, row: int, turn: int) -> int:
        """Cells of row `above` that lie to the right of where they look on `row`."""
        if self.width == 0:
            return 0
        cells_in_turn = (turn * self.cells(above) + self.width // 2) // self.width
        apart = self.rotation[above] - self.rotation[row]
        apart = apart - TURN * (abs(apart) // TURN) * (1 if apart > 0 else -1)  # remainder with the sign of `apart`
        if apart < -(TURN // 2):
            apart += TURN
        if apart > TURN // 2:
            apart -= TURN
        return (2 * apart * cells_in_turn + TURN) // (2 * TURN)

    def above(self, cells: list[list[int]], above: int, row: int, turn: int, none: int = 1) -> list[int]:
        """Row `above` as seen from `row`; beyond its ends a row goes on as it ends. Cell k is at k + 8.

        none: what a row without cells is everywhere
        """
        count = self.cells(row)
        if above < 0 or not cells[above]:
            return [none] * (count + 16)
        shift, have = self.shift(above, row, turn), len(cells[above])
        if self.half[above] == self.half[row]:
            return [cells[above][max(0, min(have - 1, k + shift))] for k in range(-8, count + 8)]
        seen = [cells[above][max(0, min(have - 1, at + shift))] for at in self.across[self.half[row]]]
        return padded(seen)

    def earlier(self, earlier: Mask, row: int, shift: int) -> list[int]:
        """Row of the earlier mask as seen from here. Cell k is at k + 8."""
        last = earlier.shape[1] - 1
        columns = self.columns[self.half[row]]
        return padded([int(earlier[row, max(0, min(last, column + shift))]) for column in columns])


def padded(row: list[int]) -> list[int]:
    """A row with eight cells more at each end."""
    return [row[0]] * 8 + row + [row[-1]] * 8 if row else [1] * 16


def count_class(count: int, size: int) -> int:
    """Returns among `size` cells: 0 none, 1 some, 2 nearly all, 3 all."""
    return 3 if count == size else 2 if count >= size - size // 4 else int(count > 0)


def code_row(
    bits: Bits,
    models: tuple[dict[int, BitModel], dict[int, BitModel], list[Mixer]],
    row: list[int],
    u: list[int],
    v: list[int],
    p: list[int] | None,
) -> None:
    """Code one row, in place: u and v are the rows above, p the earlier mask's."""
    first, second, mixers = models
    left, left2, run = 1, 1, 0
    for k in range(len(row)):
        at, run_class = k + 8, RUN_CLASS[run]
        if p is None:
            a_key = u[at] | count_class(sum(v[at - 6 : at + 7]), 13) << 1 | run_class << 3 | left << 7
            near = [u[at], u[at - 2], u[at - 1], u[at + 1], u[at + 2], v[at], v[at + 1], left, left2]
            b_key = sum(bit << place for place, bit in enumerate(near))
        else:
            about = count_class(sum(p[at - 3 : at + 4]), 7)
            a_key = u[at] | v[at + 1] << 1 | p[at] << 2 | about << 3 | left2 << 5 | left << 7
            near = [u[at], u[at - 1], u[at + 1], p[at], p[at - 3], p[at - 1], p[at + 1], left]
            b_key = sum(bit << place for place, bit in enumerate(near)) | run_class << 8
        prior = PRIOR[2 * left + u[at]]
        a = first.setdefault(a_key, BitModel(prior))
        sure = a.probability()
        if sure < SURE or sure > 65536 - SURE:
            bit = bits.bit(row[k], sure)
        else:
            b, mixer = second.setdefault(b_key, BitModel(prior)), mixers[2 * left + u[at]]
            bit = bits.bit(row[k], mixer.mix(a, b))
            mixer.update(bit)
            b.update(bit)
        a.update(bit)
        row[k] = bit
        run = min(run + 1, 15) if bit == left else 0
        left2, left = left, bit


def code_mask(bits: Bits, layout: Layout, rows: list[list[int]], turn: int, shift: int, earlier: Mask | None) -> None:
    """Code all rows, in place."""
    models: tuple[dict[int, BitModel], dict[int, BitModel], list[Mixer]] = ({}, {}, [Mixer() for _ in range(4)])
    for row in range(ROWS):
        u, v = (layout.above(rows, row - up, row, turn) for up in (1, 2))
        p = None if earlier is None else layout.earlier(earlier, row, shift)
        code_row(bits, models, rows[row], u, v, p)


def closed_rows(mask: Mask, columns: list[list[int]]) -> tuple[list[list[int]], bytes | None]:
    """Rows of a (64, W) mask, closed up to their columns; and the section of one whose cells are all alike, else None.

    Raises SectionError if a cell is set that is in no column.
    """
    rows = [[int(mask[row, column]) for column in columns[row]] for row in range(ROWS)]
    returned = sum(map(sum, rows))
    if returned != int(mask.sum()):
        raise SectionError("a mask is set in a block that did not fire")
    alike = NONE if returned == 0 else ALL if returned == sum(map(len, rows)) else None
    return rows, None if alike is None else bytes([alike])


def encode_mask(mask: Mask, layout: Layout, turn: int, shift: int = 0, earlier: Mask | None = None) -> bytes:
    """Bytes of a (64, W) mask."""
    rows, alike = closed_rows(mask, [layout.columns[half] for half in layout.half])
    if alike is not None:
        return alike
    head = bytes([ALONE if earlier is None else WITH_EARLIER]) + turn.to_bytes(2, "little")
    bits = BitWriter()
    code_mask(bits, layout, rows, turn, shift, earlier)
    return head + (b"" if earlier is None else shift.to_bytes(2, "little", signed=True)) + bits.finish()


def decode_mask(data: bytes, layout: Layout, earlier: Mask | None = None) -> Mask:
    """(64, W) uint8. Raises SectionError or TruncatedError."""
    if not data:
        raise TruncatedError("a mask section holds no bytes")
    kind, header = data[0], {NONE: 1, ALL: 1, ALONE: 3, WITH_EARLIER: 5}.get(data[0], 0)
    if header == 0:
        raise SectionError("a mask section of an unknown kind")
    if len(data) < header:
        raise TruncatedError("a mask section ends within its header", len(data))
    rows = [[int(kind == ALL)] * layout.cells(row) for row in range(ROWS)]
    if kind in (NONE, ALL):
        if len(data) != 1:
            raise SectionError("bytes after the end of a mask section", 1)
    else:
        if kind == WITH_EARLIER and earlier is None:
            raise SectionError("a mask section needs the mask of an earlier frame")
        turn, shift = int.from_bytes(data[1:3], "little"), int.from_bytes(data[3:header], "little", signed=True)
        bits = BitReader(data[header:])
        code_mask(bits, layout, rows, turn, shift, earlier if kind == WITH_EARLIER else None)
        bits.finish()
    mask = np.zeros((ROWS, layout.width), np.uint8)
    for row in range(ROWS):
        mask[row, layout.columns[layout.half[row]]] = rows[row]
    return mask

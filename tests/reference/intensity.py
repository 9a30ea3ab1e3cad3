"""The intensity coder in pure Python: same bytes as native/src/planes/intensity_*.hpp, for reading and for tests.

The turn and the rate are the encoder's choice and not part of the format: here they are given.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from lidarcodec.errors import SectionError, TruncatedError
from tests.reference.mask import ROWS, Layout
from tests.reference.range_coder import BitModel, BitReader, Bits, BitWriter
from tests.reference.wide_coder import WideReader, WideWriter

CONSTANT, CODED, GOES_ON, FOLLOWED = range(4)
HEAD_BYTES: Final = 11
ON_BYTES: Final = 9
MAX_RATE: Final = 8191
MASS_CLASSES: Final = 48
ONE: Final = 32767
RAREST: Final = 10
DIRECTIONS, DIRECTION_STEP = 2000, 18

Image = npt.NDArray[np.uint8]


class Symbols:
    """The values in use, their classes by mass, and the tree whose leaves they are."""

    def __init__(self, values: list[int], classes: list[int]) -> None:
        self.values, self.classes = values, classes
        self.depth = max(1, (len(values) - 1).bit_length())
        self.leaf = [(symbol << self.depth) // len(values) for symbol in range(len(values))]
        self.centre = {}  # of each sixteenth of the mass, in half leaves
        for sixteenth in {c // 3 for c in classes}:
            members = [symbol for symbol, c in enumerate(classes) if c // 3 == sixteenth]
            self.centre[sixteenth] = (members[0] + members[-1] + 1 << self.depth) // len(values)

    @classmethod
    def of(cls, values: list[int]) -> Symbols:
        """Of the intensities of all returns."""
        used, before, classes = sorted(set(values)), 0, []
        for value in used:
            count = values.count(value)
            classes.append((2 * before + count) * MASS_CLASSES // (2 * len(values)))
            before += count
        return cls(used, classes)


def code_symbols(bits: Bits, symbols: Symbols | None) -> tuple[list[int], list[int]]:
    """Write or read values in use and classes."""

    def code(bit: bool, model: BitModel) -> int:
        came = bits.bit(int(bit), model.probability())
        model.update(came)
        return came

    used, recent, values = [BitModel() for _ in range(8)], 0, []
    for value in range(256):
        is_used = code(symbols is not None and value in symbols.values, used[recent])
        if is_used:
            values.append(value)
        recent = (recent << 1 | is_used) & 7
    rise, rises, at, classes = [BitModel(), BitModel()], 0, 0, []
    for symbol in range(len(values)):
        while at < MASS_CLASSES - 1:
            rises = code(symbols is not None and symbols.classes[symbol] > at, rise[rises])
            if not rises:
                break
            at += 1
        classes.append(at)
    return values, classes


class Cells:
    """Log odds of decisions, by context and the way to each in the tree."""

    def __init__(self, symbols: Symbols) -> None:
        self._symbols = symbols
        self._cells: dict[tuple[tuple[int, ...], int, int], int] = {}

    def sum(self, contexts: list[tuple[int, ...]], level: int, way: int) -> int:
        """Log odds of a decision in all contexts."""
        a, b, c, d, e, f, g, *of_row = (self._get(context, level, way) for context in contexts)
        alone = clamp16(clamp16(clamp16(a + b) + clamp16(c + d)) + clamp16(clamp16(e + f) + g))
        return clamp16(alone + clamp16(sum(of_row)))

    def move(self, contexts: list[tuple[int, ...]], level: int, way: int, by: int) -> None:
        """Learn a decision."""
        for context in contexts:
            self._cells[context, level, way] = clamp16(self._get(context, level, way) + by)

    def _get(self, context: tuple[int, ...], level: int, way: int) -> int:
        key = (context, level, way)
        if key not in self._cells:
            self._cells[key] = self._start(context, level, way)
        return self._cells[key]

    def _start(self, context: tuple[int, ...], level: int, way: int) -> int:
        s = self._symbols
        if context[0] == 0:
            half = 1 << (s.depth - level)
            return max(-half, min(half, s.centre[context[1]] - (2 * way + 1) * half)) * 21845 >> s.depth
        if context[0] == 5:
            zero, one = (any(leaf >> (s.depth - level - 1) == 2 * way + bit for leaf in s.leaf) for bit in (0, 1))
            return 0 if zero == one else 32767 if one else -32768
        return 0


def clamp16(value: int) -> int:
    """Value, but at least -32768 and at most 32767."""
    return max(-32768, min(32767, value))


def probability_of(odds: int) -> int:
    """Probability of a one, of 32768."""
    t = 65534 - 2 * (-1 - odds if odds < 0 else odds)
    rare = max((t * t >> 16) * t >> 18, RAREST)
    return rare if odds < 0 else ONE - rare


class Sent:
    """What a stream sent last in each direction of each row."""

    def __init__(self) -> None:
        self._values: dict[tuple[int, int], int] = {}

    def put(self, row: int, direction: int, value: int | None) -> None:
        """Value of a return, or None."""
        self._values.pop((row, direction), None)
        if value is not None:
            self._values[row, direction] = value

    def before(self, row: int, direction: int, s: Symbols) -> int:
        """The class of what was sent around a direction; 0 if nothing was."""
        around = [self._values.get((row, (direction + step) % DIRECTIONS)) for step in (0, 0, -1, 1)]
        known = [s.values.index(value) if value in s.values else 0 for value in around if value is not None]
        return 1 + s.classes[sum(known) // len(known)] // 3 if known else 0


def contexts_of(
    last: list[int], up: list[int], gap: int, edges: int, s: Symbols, of_row: tuple[int, int] | None
) -> list[tuple[int, ...]]:
    """Contexts of a return. last: four symbols of its row, latest first; up: cells -1 to 2 of the row above.

    of_row: where frames go on from each other, the row, and the class of what was sent around the direction
    """
    a, b, c, d = last
    guess, around = (2 * (a + b) + c + d + up[1] + up[2]) // 8, sum(up) // 4
    of3, of6, of8, of12 = ([x // n for x in s.classes] for n in (3, 6, 8, 12))
    fine = [symbol // 2 if s.depth == 8 else symbol for symbol in range(len(s.values))]
    of2, of10 = ([x // n for x in s.classes] for n in (2, 10))
    row, before = of_row or (0, 0)
    more = [] if of_row is None else [(7, row, of2[a]), (8, row, of10[b], of10[a])]
    return [
        (0, of3[guess], of3[a] if of_row is None else before),
        (1, fine[a], of3[b]),
        (2, fine[b], of3[a]),
        (3, of6[a], of6[b], of6[c]),
        (4, of8[a], of8[b], of8[c], of8[d]),
        (5, gap),
        (6, edges, of6[a], of12[around]),
        *more,
    ]


Coder = WideWriter | WideReader


class RowCoder:
    """Codes rows of symbols, the two halves of a row in turns."""

    def __init__(self, symbols: Symbols, rate: int, coders: tuple[Coder, Coder], sent: Sent | None = None) -> None:
        self._symbols, self._rate, self._coders, self._sent = symbols, rate, coders, sent
        self._cells = Cells(symbols)
        self._last = [[0] * 4, [0] * 4]
        self._ends: dict[int, list[int]] = {}

    def go_on(self, rate: int, coders: tuple[Coder, Coder]) -> RowCoder:
        """This coder, for the next section."""
        self._rate, self._coders = rate, coders
        return self

    @property
    def values(self) -> list[int]:
        """The values in use."""
        return self._symbols.values

    @property
    def follows(self) -> bool:
        """Whether frames go on from each other."""
        return self._sent is not None

    def code(self, number: int, mask: list[int], above: list[int], row: list[int], directions: list[int]) -> None:
        """Code a row in place. mask: which cells are returns; above: cell k of the row above is at k + 8."""
        sent = [self._sent.before(number, at, self._symbols) for at in directions] if self._sent else []
        cells = [k for k in range(len(row)) if mask[k]]
        half = (len(cells) + 1) // 2
        for h, first in enumerate((0, half)):
            if h == 0 and number in self._ends:
                self._last[0] = self._ends[number]
            elif first < len(cells):
                self._last[h] = [above[cells[first] + 8]] * 4
        for i in range(half):
            turn = [(0, i)] + ([(1, half + i)] if half + i < len(cells) else [])
            about = []
            for h, j in turn:
                k, before = cells[j], cells[j - 1] if j else -1
                edges = 2 * (k > 0 and not mask[k - 1]) + (k + 1 < len(row) and not mask[k + 1])
                gap = min(k - before - 1, 3)
                of_row = (number, sent[k]) if self._sent else None
                about.append(contexts_of(self._last[h], above[k + 7 : k + 11], gap, edges, self._symbols, of_row))
            leaves = self._walk([h for h, _ in turn], about, [self._symbols.leaf[row[cells[j]]] for _, j in turn])
            for (h, j), leaf in zip(turn, leaves, strict=True):
                if leaf not in self._symbols.leaf:
                    raise SectionError("an intensity that is none of those announced")
                row[cells[j]] = self._symbols.leaf.index(leaf)
                self._last[h] = [row[cells[j]], *self._last[h][:3]]
        if cells:
            self._ends[number] = self._last[len(cells) > 1]
        for k, at in enumerate(directions if self._sent else []):
            self._sent.put(number, at, self.values[row[k]] if mask[k] else None)

    def _walk(self, halves: list[int], about: list[list[tuple[int, ...]]], leaves: list[int]) -> list[int]:
        depth, ways = self._symbols.depth, [0] * len(halves)
        for levels in (range(min(depth, 4)), range(4, depth)):
            learned = []
            for i, h in enumerate(halves):  # nothing is learned before both halves know what they expect
                for level in levels:
                    p = probability_of(self._cells.sum(about[i], level, ways[i]))
                    bit = self._coders[h].bit(leaves[i] >> (depth - level - 1) & 1, p)
                    by = ((ONE if bit else 0) - p) * self._rate + 0x8000 >> 16
                    learned.append((about[i], level, ways[i], by))
                    ways[i] = 2 * ways[i] + bit
            for contexts, level, way, by in learned:
                self._cells.move(contexts, level, way, by)
        return ways


def code_rows(
    layout: Layout,
    mask: list[list[int]],
    rows: list[list[int]],
    turn: int,
    coder: RowCoder,
    azimuth: npt.NDArray[np.uint16] | None = None,
) -> None:
    """Code all rows of symbols in place. mask: closed-up rows; azimuth: (2, W), where frames go on from each other."""
    filled: list[list[int]] = []
    directions: list[list[int]] = [[], []]
    if azimuth is not None:
        directions = [[int(azimuth[half, at]) // DIRECTION_STEP for at in layout.columns[half]] for half in (0, 1)]
    for row in range(ROWS):
        above = layout.above(filled, row - 1, row, turn)
        coder.code(row, mask[row], above, rows[row], directions[layout.half[row]])
        seen = above[8 : 8 + len(rows[row])]
        symbol = next((s for s, is_return in zip(rows[row], mask[row], strict=True) if is_return), None)
        if symbol is not None:
            seen = [symbol := s if is_return else symbol for s, is_return in zip(rows[row], mask[row], strict=True)]
        filled.append(seen)


def closed_up(image: npt.NDArray[np.uint8] | npt.NDArray[np.uint16], layout: Layout) -> list[list[int]]:
    """The fired cells of each row."""
    return [[int(image[row, column]) for column in layout.columns[layout.half[row]]] for row in range(ROWS)]


def encode_intensity(values: Image, returns: Image, layout: Layout, turn: int, rate: int) -> bytes:
    """Bytes of (64, W) intensities. returns: (64, W) uint8 of 0 and 1."""
    mask, rows = closed_up(returns, layout), closed_up(values, layout)
    if sum(map(sum, mask)) != int(returns.sum()):
        raise SectionError("a mask is set in a block that did not fire")
    present = [int(value) for value in values[returns != 0]]
    if len(set(present)) < 2:
        return bytes([CONSTANT, present[0]]) if present else b""
    symbols, head, coders = Symbols.of(present), BitWriter(), (WideWriter(), WideWriter())
    code_symbols(head, symbols)
    known = [
        [symbols.values.index(v) if m else 0 for v, m in zip(*row, strict=True)] for row in zip(rows, mask, strict=True)
    ]
    code_rows(layout, mask, known, turn, RowCoder(symbols, rate, coders))
    announced, first, second = head.finish(), *(coder.finish() for coder in coders)
    sizes = [(CODED, 1), (turn, 2), (rate, 2), (len(announced), 2), (len(first), 4)]
    return b"".join(value.to_bytes(size, "little") for value, size in sizes) + announced + first + second


class Memory:
    """What sections taught."""

    def __init__(self) -> None:
        self.coder: RowCoder | None = None
        self.sent = Sent()


def decode_intensity(
    data: bytes,
    returns: Image,
    layout: Layout,
    memory: Memory | None = None,
    azimuth: npt.NDArray[np.uint16] | None = None,
) -> Image:
    """(64, W) uint8. memory: what to go on from, changed; azimuth: (2, W).

    Raises SectionError or TruncatedError.
    """
    image, mask = np.zeros((ROWS, layout.width), np.uint8), closed_up(returns, layout)
    if not returns.any():
        if data:
            raise SectionError("intensities where there are no returns")
        return image
    if len(data) < 2:
        raise TruncatedError("intensities end within their header", len(data))
    if data[0] == CONSTANT:
        if len(data) != 2:
            raise SectionError("bytes after the end of intensities", 2)
        image[returns != 0] = data[1]
        return image
    before = None if memory is None else memory.coder
    if data[0] > FOLLOWED or (data[0] == GOES_ON and before is None):
        raise SectionError("intensities of an unknown kind, or that go on where nothing began")
    begins, follows = data[0] != GOES_ON, data[0] == FOLLOWED or (data[0] == GOES_ON and before.follows)
    if follows and (memory is None or azimuth is None):
        raise SectionError("intensities of a stream, where none goes on")
    size = HEAD_BYTES if begins else ON_BYTES
    if len(data) < size:
        raise TruncatedError("intensities end within their header", len(data))
    turn, rate, first = (int.from_bytes(data[at:to], "little") for at, to in ((1, 3), (3, 5), (size - 4, size)))
    head = int.from_bytes(data[5:7], "little") if begins else 0
    if not 0 < rate <= MAX_RATE:
        raise SectionError("intensities that learn at a rate beyond the limits", 3)
    split = size + head
    if split + first > len(data):
        raise TruncatedError("intensities end before their streams do", len(data))
    coders = WideReader(data[split : split + first]), WideReader(data[split + first :])
    if begins:
        bits = BitReader(data[HEAD_BYTES:split])
        values, classes = code_symbols(bits, None)
        bits.finish()
        if len(values) < 2:
            raise SectionError("intensities of fewer than two values", HEAD_BYTES)
        sent = memory.sent if follows and memory else None
        coder_of_rows = RowCoder(Symbols(values, classes), rate, coders, sent)
    else:
        assert before is not None
        coder_of_rows = before.go_on(rate, coders)
        values = coder_of_rows.values
    rows = [[0] * len(row) for row in mask]
    code_rows(layout, mask, rows, turn, coder_of_rows, azimuth if follows else None)
    if memory is not None:
        memory.coder = coder_of_rows
    for coder in coders:
        coder.finish()
    for row in range(ROWS):
        columns = np.array(layout.columns[layout.half[row]], np.intp)
        came = np.array([values[symbol] for symbol in rows[row]], np.uint8)
        image[row, columns] = came * np.array(mask[row], np.uint8)
    return image

"""The azimuth coder in pure Python: same bytes as native/src/planes/azimuth_coder.cpp, for reading and for tests.

Arrays are nested lists: azimuth[half][column] and fired[half][column], half 0 the upper.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import Final

from lidarcodec.errors import SectionError, TruncatedError
from tests.reference.range_coder import BitModel, BitReader, Bits, BitWriter, Mixer, NumberModel

TURN: Final = 36000
STEPS: Final = 4
RUNS: Final = 16
ALL_FIRED, LOWER_FIRST, STEPS_SHIFT, KNOWN = 1, 2, 2, 0x1F

Rows = list[list[int]]


class StepModel:
    """Codes the step from one rotation to the next; `table` lists the most frequent."""

    def __init__(self, table: list[int]) -> None:
        self._table = table
        self._by_two_runs: dict[tuple[int, int, int], BitModel] = {}
        self._by_three_runs: dict[tuple[int, int, int], BitModel] = {}
        self._mixer, self._others = Mixer(), NumberModel()
        self._numbers = [[BitModel() for _ in range(STEPS - 1)] for _ in range(STEPS)]
        self._run, self._last, self._runs = 0, 0, (0, 0)

    def code(self, bits: Bits, step: int) -> int:
        """Encode `step`, 0 to 35999, or decode one."""
        wanted = self._table.index(step) if step in self._table else STEPS
        a = self._by_two_runs.setdefault((self._run, self._runs[0], self._last), BitModel())
        b = self._by_three_runs.setdefault((self._run, *self._runs), BitModel())
        again = bits.bit(int(wanted == 0), self._mixer.mix(a, b))
        for model in (self._mixer, a, b):
            model.update(again)
        number = 0
        if again:
            self._run = min(self._run + 1, RUNS - 1)
        else:
            self._runs, self._run = (self._run, self._runs[0]), 0
            for number in range(1, STEPS + 1):
                if number == STEPS or self._numbers[self._last][number - 1].code(bits, int(wanted == number)):
                    break
            self._last = min(number, STEPS - 1)
        if number < STEPS:
            if number >= len(self._table):
                raise SectionError("a rotation step that the section does not list")
            return self._table[number]
        other = self._others.code(bits, step)
        if other >= TURN:
            raise SectionError("a rotation step of more than a turn")
        return other


def code_columns(bits: Bits, table: list[int], flags: int, azimuth: Rows, fired: Rows) -> None:
    """Code all columns; a decoder fills `azimuth` and `fired` in."""
    steps, same, recent = StepModel(table), [BitModel() for _ in range(4)], 3
    firing = [[BitModel() for _ in range(4)] for _ in range(64)]
    before = at = 0
    for column in range(len(azimuth[0])):
        halves = 3
        if not flags & ALL_FIRED:
            high = firing[before][1].code(bits, fired[1][column])
            halves = high << 1 | firing[before][2 | high].code(bits, fired[0][column])
            before = (before << 2 | halves) & 63
        first = int(halves == 2 or (halves == 3 and bool(flags & LOWER_FIRST)))
        wanted = azimuth[first][column]
        at = (at + steps.code(bits, (wanted - at) % TURN)) % TURN
        azimuth[first][column] = at
        if halves == 3:
            equal = same[recent].code(bits, int(azimuth[1 - first][column] == wanted))
            recent = (recent << 1 | equal) & 3
            if not equal:
                at = (at + steps.code(bits, (azimuth[1 - first][column] - at) % TURN)) % TURN
        azimuth[1 - first][column] = at
        fired[0][column], fired[1][column] = halves & 1, halves >> 1


def steps_of(azimuth: Rows, fired: Rows, lower_first: bool) -> Iterator[int]:
    """Steps in the order in which the coder meets them."""
    at = 0
    for column in range(len(azimuth[0])):
        both = fired[0][column] and fired[1][column]
        lower = not fired[0][column] or (both and lower_first)
        first, second = azimuth[1 if lower else 0][column], azimuth[0 if lower else 1][column]
        yield (first - at) % TURN
        if first != second:
            yield (second - first) % TURN
        at = second


def encode_azimuth(azimuth: Rows, fired: Rows) -> bytes:
    """Bytes of the rotations of a frame."""
    pairs = list(zip(azimuth[0], azimuth[1], fired[0], fired[1], strict=True))
    apart = [(upper - lower) % TURN for upper, lower, *half in pairs if all(half) and upper != lower]
    lower_first = 2 * sum(step < TURN // 2 for step in apart) > len(apart)
    counts = Counter(steps_of(azimuth, fired, lower_first))
    often = sorted((-count, step) for step, count in counts.items() if count >= 3)
    table = [step for _, step in often[:STEPS]]
    all_fired = all(upper and lower for *_, upper, lower in pairs)
    flags = all_fired * ALL_FIRED | lower_first * LOWER_FIRST | len(table) << STEPS_SHIFT
    bits = BitWriter()
    code_columns(bits, table, flags, [list(row) for row in azimuth], [list(row) for row in fired])
    return bytes([flags]) + b"".join(step.to_bytes(2, "little") for step in table) + bits.finish()


def decode_azimuth(data: bytes, width: int) -> tuple[Rows, Rows]:
    """azimuth and fired of `width` columns. Raises SectionError or TruncatedError."""
    if not data:
        raise TruncatedError("an azimuth section holds no bytes")
    flags, count = data[0], data[0] >> STEPS_SHIFT
    if flags > KNOWN or count > STEPS:
        raise SectionError("an azimuth section with unknown flags")
    header = 1 + 2 * count
    if len(data) < header:
        raise TruncatedError("an azimuth section ends within its steps", len(data))
    table = [int.from_bytes(data[at : at + 2], "little") for at in range(1, header, 2)]
    if any(step >= TURN for step in table):
        raise SectionError("a rotation step of more than a turn", 1)
    azimuth, fired = [[0] * width, [0] * width], [[0] * width, [0] * width]
    bits = BitReader(data[header:])
    code_columns(bits, table, flags, azimuth, fired)
    bits.finish()
    return azimuth, fired

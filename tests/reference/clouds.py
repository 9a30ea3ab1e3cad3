"""Rests and directions of a CLOUD section, written after docs/wire-format-clouds.md alone: slow, and easy to check."""

from __future__ import annotations

from collections.abc import Sequence

SLOTS = 2048


class Reader:
    """Bytes one after the other."""

    def __init__(self, data: bytes) -> None:
        self.data = data

    def take(self, count: int) -> bytes:
        found, self.data = self.data[:count], self.data[count:]
        assert len(found) == count
        return found

    def varint(self) -> int:
        number = shift = 0
        while (byte := self.take(1)[0]) > 0x7F:
            number |= (byte & 0x7F) << shift
            shift += 7
        return number | byte << shift

    def sized(self) -> bytes:
        return self.take(self.varint())


class Table:
    """The tokens of one context."""

    def __init__(self, tokens: int) -> None:
        self.counts = [max(32 >> token, 1) for token in range(tokens)]
        self.period = self.left = 16
        self._build()

    def _build(self) -> None:
        tokens, total = len(self.counts), sum(self.counts)
        self.frequencies = [1 + count * (SLOTS - tokens) // total for count in self.counts]
        self.frequencies[self.counts.index(max(self.counts))] += SLOTS - sum(self.frequencies)
        if total > 1024:
            self.counts = [(count + 1) // 2 for count in self.counts]

    def token(self, slot: int) -> tuple[int, int, int]:
        """Token, frequency and start of a slot."""
        start = 0
        for token, frequency in enumerate(self.frequencies):
            if slot < start + frequency:
                return token, frequency, start
            start += frequency
        raise AssertionError(slot)

    def take(self, token: int) -> None:
        self.counts[token] += 1
        self.left -= 1
        if self.left == 0:
            self.period = self.left = min(2 * self.period, 128)
            self._build()


class Rests:
    """The numbers of a series, one after the other."""

    def __init__(self, data: bytes) -> None:
        reader = Reader(data)
        self.tokens = reader.take(1)[0]
        self.tables: dict[int, Table] = {}
        self.at = 0
        if self.tokens:
            self.states = [int.from_bytes(reader.take(4), "little") for _ in range(4)]
            self.words = [int.from_bytes(reader.take(2), "little") for _ in range(reader.varint())]
            self.bits = int.from_bytes(reader.data, "little")

    def next(self, context: int) -> int:
        if not self.tokens:
            return 0
        table = self.tables.setdefault(context, Table(self.tokens))
        state, lane = self.states[self.at % 4], self.at % 4
        self.at += 1
        token, frequency, start = table.token(state % SLOTS)
        state = frequency * (state // SLOTS) + state % SLOTS - start
        if state < 65_536:
            state = state * 65_536 + self.words.pop(0)
        self.states[lane] = state
        table.take(token)
        if token < 16:
            return token
        bits = token - 12
        low, self.bits = self.bits & ((1 << bits) - 1), self.bits >> bits
        return 1 << bits | low

    def used_up(self) -> bool:
        return not self.tokens or (self.states == [65_536] * 4 and not self.words and not self.bits)


def field_rests(data: bytes, cells: Sequence[tuple[int, int]]) -> list[int]:
    """Rests of a field of points in these cells (row, column)."""
    rests, rows, columns, found = Rests(data), dict[int, int](), dict[int, int](), []
    for row, column in cells:
        number = rests.next(4 * min(rows.get(row, 0), 3) + min(columns.get(column, 0), 3))
        rows[row] = columns[column] = number
        found.append(number)
    assert rests.used_up()
    return found


def unzigzag(number: int) -> int:
    return -(number + 1) // 2 if number % 2 else number // 2


def directions(rests: Rests, cells: Sequence[tuple[int, int]], turn: int, step: int | None) -> list[int]:
    """k of points in these cells. step: by row; None: by column."""

    def wrapped(k: int) -> int:
        return (k + turn // 2) % turn - turn // 2

    found = []
    ks: dict[int, tuple[int, int]] = {}
    lengths: dict[int, int] = {}
    positions: dict[int, int] = {}
    of_column: dict[int, int] = {}
    last_column = last_position = offset = 0
    mean: int | None = None
    for row, column in cells:
        if step is not None:
            told = ks[row][0] + step if row in ks else offset
            e = unzigzag(rests.next(3 * lengths.get(row, 0)))
            k = wrapped(told + e)
            if row not in ks:
                offset = k
        else:
            known = column in positions
            ahead = ((mean or 0) * (column - last_column) + 128) // 256
            position = wrapped(positions[column] if known else last_position + ahead)
            told = position + (ks[row][0] - positions[ks[row][1]] if row in ks else offset)
            i = lengths.get(row, 0)
            e = unzigzag(rests.next(3 * i + of_column[column] if known else 9 + i))
            k = wrapped(told + e)
            if row in ks:
                position = wrapped(position + e)
            else:
                offset = wrapped(k - position)
            if not known and column > last_column:
                now = 256 * wrapped(position - last_position) // (column - last_column)
                mean = now if mean is None else mean + (now - mean) // 8
            positions[column], of_column[column] = position, min(abs(e), 2)
            last_column, last_position = column, position
        ks[row], lengths[row] = (k, column), min(abs(e), 2)
        found.append(k)
    assert rests.used_up()
    return found


class Coordinates:
    """Contexts of the rests of one coordinate."""

    def __init__(self, rests: Rests) -> None:
        self.rests = rests
        self.lengths: dict[int, int] = {}

    def next(self, row: int, exponent: int, exponent_of_rho: int) -> int:
        """The rest of a point in a row. exponent: of the coordinate that is told."""
        i = min(max(exponent_of_rho - exponent + 1, 0), 7)
        number = self.rests.next(8 * i + self.lengths.get(row, 0))
        self.lengths[row] = min(number.bit_length(), 7)
        return unzigzag(number)

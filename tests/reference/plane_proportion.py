"""The proportion of an attribute to another, after docs/wire-format-planes.md, "Proportions"."""

from __future__ import annotations

from collections import defaultdict

from tests.reference.plane_rows import clamp


class Proportion:
    """What is learned of it. `expect` gives P[3], and `learn` takes the number that there was."""

    def __init__(self) -> None:
        self.values: dict[int, int] = {}
        self.counts: dict[int, int] = defaultdict(int)
        self.factors: dict[tuple[int, int], int] = defaultdict(lambda: 4096)
        self.last, self.row, self.cells = 1 << 16, 1 << 14, 0

    def expect(self, t: int, y: int, most: int) -> int:
        """P[3] of the number t of the mate and the range y."""
        octave = (16 + y).bit_length() - 5
        self.c = 16 * octave + ((16 + y) >> octave) - 16
        self.part = ((16 + y) % (1 << octave) << 8) >> octave
        first = self.values.get(self.c, self.values.get(self.c + 1, self.last))
        second = self.values.get(self.c + 1, first)
        self.line = (first * (256 - self.part) + second * self.part) >> 8
        self.fit = min(self.line * (2 * t + 1) >> 1, 2**40)
        self.uneven = (t, octave) if 64 <= t < 256 else None
        if self.uneven:
            self.fit = self.fit * self.factors[self.uneven] >> 12
        self.fit = self.fit * self.row >> 14
        return min((self.fit + 32768) >> 16, most)

    def learn(self, n: int, t: int) -> None:
        """Learn from a number."""
        if t == 0:
            return
        off = clamp((n << 28) // max(self.fit, 4096) - 4096, -3500, 32768)
        for c, part in ((self.c, 256 - self.part), (self.c + 1, self.part)):
            if c not in self.values:
                if part >= 64:
                    self.values[c], self.counts[c] = clamp(self.line + (self.line * off >> 12), 1, 2**30), 1
                continue
            value, slow = self.values[c], self.counts[c].bit_length()
            self.values[c] = clamp(value + (value * off * part >> (20 + slow)), 1, 2**30)
            if part >= 128:
                self.counts[c] = min(self.counts[c] + 1, 4)
        self.last = self.values.get(self.c, self.values.get(self.c + 1, 0))
        if self.uneven:
            factor = self.factors[self.uneven]
            self.factors[self.uneven] = clamp(factor + (factor * off >> 14), 64, 65536)
        self.cells += 1
        slow = 5 if self.cells <= 32 else 6 if self.cells <= 96 else 7
        self.row = clamp(self.row + (self.row * clamp(off, -512, 512) >> (12 + slow)), 4096, 65536)

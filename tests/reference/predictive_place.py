"""What the predictive coder in pure Python knows of a return before it is coded: contexts, and ranges it may be near.

Same as native/src/predictive/*.hpp; `predictive` codes with it.
"""

from __future__ import annotations

from typing import Final

from tools import predictive_tables as tables

MAX_DIFFERENCE: Final = 1 << 20
MARGIN: Final = 8
FIRINGS: Final = 24

LAST, LEVELLED, PLAIN, SLOPE, MEAN, UPPER, STEP, UPPER_SLOPE = range(0, 32, 4)
SCALE, MASK, MEAN_SIZE, LAST_SIZE, UP_SIZE, LAST_LEAF = range(32, 38)
SEEN, SEEN_PLAIN, SEEN_SLOPE, SURPRISE = range(38, 54, 4)
SEEN_MASK, SEEN_SIZE = 54, 55
CONTEXTS: Final[tuple[tuple[int, ...], ...]] = (
    (LAST + 1, LAST + 2),
    (PLAIN + 1, MEAN_SIZE),
    (LAST, LAST + 3),
    (MASK, SLOPE + 1, LEVELLED + 3),
    (SCALE, LAST),
    (UPPER + 2, MASK, LAST + 1),
    (UPPER_SLOPE + 1, PLAIN + 2),
    (MEAN + 3, LAST),
    (LAST_LEAF, LAST_SIZE, LAST + 3),
)
"""Features of each context, of 16 classes where there are two of them, else of 8."""
EXPECTED_CONTEXTS: Final[tuple[tuple[int, ...], ...]] = (
    (SEEN_PLAIN, SEEN_SLOPE),
    (SEEN + 1, SEEN_SLOPE + 1, LAST),
    (SEEN + 2, SEEN_PLAIN + 2),
    (SEEN + 3, SEEN_SLOPE + 3, MASK),
    (SEEN_PLAIN + 1, SURPRISE + 2, SCALE),
    (SEEN_PLAIN + 1, SEEN + 1),
)
"""Those of frames that know what to expect, beside the others."""
QUICK_ALONE: Final = (0, 1, 4, 5, 6, 8, 9, 10, 11, 12, 13)
QUICK_EXPECTING: Final = (0, 1, 4, 5, 6, 9, 10, 13, 14, 15, 16, 17, 18)
"""Numbers of the contexts of quick kinds."""

LEAF_BITS: Final = [
    [[*tables.width_bits(c, quick=quick), tables.beyond_bits(c)] for c in range(tables.CLASSES)]
    for quick in (False, True)
]
"""By whether a kind is quick, scale and leaf; of the last leaf those of what comes first beyond it."""
LIMITS: Final = [tables.limits(c) for c in range(tables.CLASSES)]
FIRST_LOG_ODDS: Final = [[tables.log_odds(c, quick=quick) for c in range(tables.CLASSES)] for quick in (False, True)]


def half_octaves(x: int) -> int:
    """2 log2 of a number, rounded down; 0 for 0."""
    octave = max(x.bit_length() - 1, 0)
    return 2 * octave + (x * x >> (2 * octave + 1) & 1)


def scale_class(mean: int) -> int:
    """Class of a mean difference, sixteenths of a cell."""
    return min(max(half_octaves(mean + 2) - 1, 0), tables.CLASSES - 1)


def leaf_start(scale: int, leaf: int, *, quick: bool) -> int:
    """Distance from the last return at which a leaf begins."""
    return sum(1 << bits for bits in LEAF_BITS[quick][scale][:leaf])


def quarters(of: int, seen_from: int) -> int:
    """Quarters of a cell that one range lies above another, both in sixteenths."""
    return of - seen_from >> 2


def nearer(step: int) -> int:
    """Sixteenths that all free cells but the middle one lie nearer than whole ones would."""
    return min(step // 5, 4)


def position(difference: int, scale: int) -> int:
    """Position, 0 to 15, of a difference in quarters of a cell."""
    d = max(-32767, min(32767, difference))
    n = sum(abs(d) >= limit for limit in LIMITS[scale])
    return 7 - n if d < 0 else 8 + n


class State:
    """What is known from the returns of a row, or of a part of one, that were coded before.

    Ranges are sixteenths of a cell, here and below.
    """

    def __init__(self, start: int) -> None:
        self.last: list[int] = []
        self.size1 = self.size2 = self.mean = start
        self.level, self.leaves = 0, (8, 8)
        self.bias, self.miss = 0, start

    def rescale(self, old: int, new: int, *, free: bool) -> None:
        """Bring it from cells of so many range steps to others, free ones or whole ones."""

        def scaled(x: int, most: int = MAX_DIFFERENCE, within: int = 1) -> int:
            size = min(abs(x) * old // new, most) // within * within
            return -size if x < 0 else size

        self.last = [scaled(x, 16 * MAX_DIFFERENCE, 1 if free else 16) for x in self.last]
        self.size1, self.size2, self.mean, self.miss = map(scaled, (self.size1, self.size2, self.mean, self.miss))
        self.level, self.bias = scaled(self.level), scaled(self.bias)


class Model:
    """What contexts have learned, and where slabs ended. Cells are log odds; a context counts how often it was seen."""

    def __init__(self) -> None:
        self.cells: dict[tuple[int, ...], list[int]] = {}
        self.offsets: dict[tuple[object, ...], int] = {}
        self.quick = False  # of which kind the last image was, and so the leaves of all trees
        self.states: list[State] = []  # of the rows where the last slab ended, in cells of `step`
        self.step, self.free = 0, False
        self.lower: Model | None = None  # of the lower half, after an image in halves

    def divide(self, *, halves: bool) -> None:
        """Before an image: the lower half gets models of its own, which begin as a copy of these, or has none."""
        if not halves:
            self.lower = None
        elif self.lower is None:
            self.lower = Model()
            self.lower.cells = {context: list(slot) for context, slot in self.cells.items()}
            self.lower.offsets, self.lower.quick = dict(self.offsets), self.quick

    def slot(self, context: tuple[int, ...]) -> list[int]:
        """16 cells: how often the context was seen, and the nodes of its tree."""
        if context not in self.cells:
            self.cells[context] = list(FIRST_LOG_ODDS[self.quick][context[1]]) if context[0] == 0 else [0] * 16
        return self.cells[context]

    def begin(self, *, quick: bool) -> None:
        """Before an image: one of other leaves than the last begins from nothing."""
        if quick != self.quick:
            self.quick, self.cells, self.offsets = quick, {}, {}


class Place:
    """What is known of a return before it is coded."""

    def __init__(
        self, half: State, about: Surroundings, k: int, first: int, *, quick: bool, free: bool = False
    ) -> None:
        at = k + MARGIN
        above, upper, sizes = about.above, about.upper, about.sizes
        self.cell = k
        newest = half.last[0] if half.last else above[at] if above else first
        up = above[at - 1 : at + 5] if above else [newest] * 6
        upper_up = upper[at - 1 : at + 5] if upper else [newest] * 6
        last = half.last[1:5] if half.last else [newest] * 4
        self.base, self.above = newest, up[1]
        if free and about.expected and about.known[at]:
            two = sorted((up[1] + half.level, about.expected[at] + half.bias))
            self.base += 1 if two[0] > newest else -1 if two[1] < newest else 0
        mean = 5 * half.size1 + 3 * half.size2 + 3 * sizes[at] + sizes[at - 1] + 2 * (sizes[at + 1] + sizes[at + 2])
        self.scale = scale_class(mean // 16)
        level = half.level >> 2
        differences = [
            [quarters(x, self.base) for x in last],
            [quarters(x, self.base) + level for x in up[:4]],
            [quarters(x, self.base) for x in up[:4]],
            [quarters(up[i + 1], up[i]) for i in range(4)],
            [up[i + 2] - up[i] >> 3 for i in range(4)],
            [quarters(x, self.base) for x in upper_up[:4]],
            [quarters(upper_up[i], up[i]) for i in range(4)],
            [quarters(upper_up[i + 1], upper_up[i]) for i in range(4)],
        ]
        of = [position(d, self.scale) for group in differences for d in group]
        m, a, b = about.mask, about.above_mask, about.below_mask
        of += [self.scale // 2, m[at + 1] | b[at] << 1 | a[at] << 2 | m[at - 1] << 3]
        of += [self._relative(size) for size in (half.mean, half.size1, sizes[at])] + [half.leaves[0]]
        near = (m[at - 1], m[at - 2], m[at + 1], m[at + 2], b[at], b[at - 1], b[at + 1], a[at], a[at + 1])
        self.contexts = [(0, self.scale), (1, *half.leaves), (2, *near), (3, of[LEVELLED + 1], self.scale)]
        self.contexts.append((4, *about.firings[k]))
        for number, features in enumerate(CONTEXTS):
            shift = len(features) - 2
            self.contexts.append((5 + number, *(of[feature] >> shift for feature in features)))
        levelled = up[1] + half.level
        self.near = [up[1], up[2], last[0], upper_up[1], up[0], last[1], levelled, up[3]]
        if about.expected:
            self._expect(half, about, at, up, of)
        if quick:
            used = QUICK_EXPECTING if about.expected else QUICK_ALONE
            self.contexts = [context for context in self.contexts if context[0] in used]

    def _expect(self, half: State, about: Surroundings, at: int, up: list[int], of: list[int]) -> None:
        seen, known, bias = about.expected[at - 1 : at + 4], about.known, half.bias >> 2
        above = about.expected_above[at - 1 : at + 3] if about.above else up
        differences = [
            [quarters(x, self.base) + bias for x in seen[:4]],
            [quarters(x, self.base) for x in seen[:4]],
            [quarters(seen[i + 1], seen[i]) for i in range(4)],
            [quarters(up[i], above[i]) for i in range(4)],
        ]
        of += [position(d, self.scale) for group in differences for d in group]
        of += [known[at - 1] | known[at + 1] << 1 | known[at] << 2 | about.above_mask[at] << 3]
        of += [self._relative(half.miss)]
        for number, features in enumerate(EXPECTED_CONTEXTS, 5 + len(CONTEXTS)):
            shift = len(features) - 2
            self.contexts.append((number, *(of[feature] >> shift for feature in features)))
        if known[at]:
            self.near = [seen[1] + half.bias, *self.near[:7]]

    def _relative(self, size: int) -> int:
        return max(0, min(15, scale_class(size) - self.scale + 7))


class Surroundings:
    """The rows around as seen from a row, cell k at k + 8."""

    def __init__(
        self,
        mask: list[int],
        above_mask: list[int],
        below_mask: list[int],
        above: list[int],
        upper: list[int],
        sizes: list[int],
    ) -> None:
        self.mask, self.above_mask, self.below_mask = mask, above_mask, below_mask
        self.above, self.upper, self.sizes = above, upper, sizes
        self.expected: list[int] = []  # ranges, and whether anything is known; empty where nothing is expected at all
        self.expected_above: list[int] = []
        self.known: list[int] = []
        self.firings: list[tuple[int, int]] = []  # of each cell: row, and firing modulo 24

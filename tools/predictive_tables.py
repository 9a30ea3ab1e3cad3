"""What the `predictive` coder knows before it has seen anything; also writes it as native/src/predictive/tables.hpp.

A scale class c stands for a mean difference of w = 2 ** ((c - 6.5) / 2) cells from one return to the next. For each:

- widths of the leaves, from the return before outwards: powers of two near .28 .32 .35 .45 .6 1 2 times w;
- limits between positions: .2 .5 .9 1.4 2.2 3.6 7 times w, in quarters of a cell;
- log odds of the decisions of a tree of 16 leaves under 0.8 logistic(0.6 w + 0.1) + 0.2 Laplace(3 w).

Quick kinds have leaves of their own, 2 ** ((c - k) // 2) wide and at least 1, with k from 17 in the middle to 6: so
narrow that ranges are about as likely anywhere in a leaf, and nothing is to be learned there
(research/notes/narrow-leaves.md).

The C++ compiler and libm of a machine have no part in it, so that all machines agree.
    python -m tools.predictive_tables > native/src/predictive/tables.hpp
"""

from __future__ import annotations

import math
import sys

CLASSES = 32
LEAVES = 16
HALF = LEAVES // 2
WIDTHS = (0.28, 0.32, 0.35, 0.45, 0.6, 1.0, 2.0)
QUICK_LEAVES = (17, 14, 11, 10, 9, 8, 6)
"""k of leaves 0 to 6: they are a cell wide up to class k + 1, then twice as wide every second class."""
LIMITS = (0.2, 0.5, 0.9, 1.4, 2.2, 3.6, 7.0)
NATURAL_UNIT = 32768 / 6
"""Steps of a cell in one natural unit of log odds (bits/cells.hpp)."""


def scale(c: int) -> float:
    """w of a class."""
    return float(2 ** ((c - 6.5) / 2))


def width_bits(c: int, *, quick: bool = False) -> list[int]:
    """log2 of the widths of leaves 0 to 6."""
    if quick:
        return [max(0, (c - k) // 2) for k in QUICK_LEAVES]
    return [max(0, math.floor(math.log2(width * scale(c)))) for width in WIDTHS]


def beyond_bits(c: int) -> int:
    """log2 of the first width beyond the last leaf."""
    return max(0, math.floor(math.log2(2 * scale(c)) + 0.5))


def limits(c: int) -> list[int]:
    """Limits between positions, quarters of a cell, at most 32767."""
    return [min(32767, round(4 * limit * scale(c))) for limit in LIMITS]


def below(x: float, w: float) -> float:
    """Probability of a difference below x."""
    logistic = 1 / (1 + math.exp(-max(-700.0, min(700.0, x / (0.6 * w + 0.1)))))
    laplace = 0.5 * math.exp(x / (3 * w)) if x < 0 else 1 - 0.5 * math.exp(-x / (3 * w))
    return 0.8 * logistic + 0.2 * laplace


def log_odds(c: int, *, quick: bool = False) -> list[int]:
    """16 cells: 0, then those of nodes 1 to 15."""
    starts = [0]
    for bits in width_bits(c, quick=quick):
        starts.append(starts[-1] + (1 << bits))
    ends = [*(start - 0.5 for start in starts[1:]), 1e9]
    mass = []
    for leaf in range(LEAVES):
        away = leaf - HALF if leaf >= HALF else HALF - 1 - leaf
        low, high = starts[away] - 0.5, ends[away]
        w = scale(c)
        part = below(high, w) - below(low, w) if leaf >= HALF else below(-low - 1, w) - below(-high - 1, w)
        mass.append(max(1e-5, part))
    cells = [0]
    for node in range(1, LEAVES):
        level = node.bit_length() - 1
        span = LEAVES >> level
        first = (node - (1 << level)) * span
        zero, one = sum(mass[first : first + span // 2]), sum(mass[first + span // 2 : first + span])
        cells.append(max(-32767, min(32767, round(math.log(one / zero) * NATURAL_UNIT))))
    return cells


def _array(name: str, kind: str, values: list[list[int]]) -> str:
    lines = ["    {" + ", ".join(map(str, row)) + "}," for row in values]
    head = f"inline constexpr {kind} {name}[{len(values)}][{len(values[0])}] = {{"
    return "\n".join([head, *lines, "};"])


def header() -> str:
    """The C++ header."""
    classes = range(CLASSES)
    beyond = ", ".join(str(beyond_bits(c)) for c in classes)
    parts = [
        "// Made by tools/predictive_tables.py, which says what these are. Not to be edited.",
        "// clang-format off",
        "#pragma once\n#include <cstdint>\n\nnamespace lidarcodec {\n",
        f"inline constexpr std::uint32_t kScaleClasses = {CLASSES};",
        _array("kLeafBits", "std::uint8_t", [width_bits(c) for c in classes]),
        _array("kQuickLeafBits", "std::uint8_t", [width_bits(c, quick=True) for c in classes]),
        f"inline constexpr std::uint8_t kBeyondBits[] = {{{beyond}}};",
        _array("kPositionLimits", "std::int16_t", [limits(c) for c in classes]),
        _array("kFirstLogOdds", "std::int16_t", [log_odds(c) for c in classes]),
        _array("kQuickFirstLogOdds", "std::int16_t", [log_odds(c, quick=True) for c in classes]),
        "\n}  // namespace lidarcodec\n",
    ]
    return "\n".join(parts)


if __name__ == "__main__":
    sys.stdout.write(header())

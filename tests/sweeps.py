"""Cases that take long and show little more than others like them: only `make sweeps` runs them.

`make sweeps` also runs the tests that draw their examples at random, with all of their examples: those of
Hypothesis, and those with the marker `drawn`, which draw from a seed of their own.
"""

from __future__ import annotations

import os
from collections.abc import Collection, Iterable
from itertools import product
from typing import Any

import pytest

ALL = os.environ.get("LIDARCODEC_EXAMPLES") == "all"


def examples(count: int) -> int:
    """How many examples a test draws: an eighth of them, at least ten, unless LIDARCODEC_EXAMPLES is `all`."""
    return count if ALL else max(10, count // 8)


def sampled(cases: Iterable[Any], kept: Collection[Any]) -> list[Any]:
    """Cases of a parameter, or tuples for several; those not among `kept` are run by `make sweeps` alone."""
    return [case if case in kept else marked(case, pytest.mark.sweep) for case in cases]


def marked(case: Any, mark: pytest.MarkDecorator) -> Any:
    """A case of a parameter, or a tuple for several, with a mark."""
    return pytest.param(*(case if type(case) is tuple else (case,)), marks=mark)


def spread(*axes: Iterable[Any]) -> list[Any]:
    """Combinations of the values of several parameters; without `make sweeps` only so many that each value occurs."""
    values = [list(axis) for axis in axes]
    return sampled(product(*values), _few(values))


def paired(first: Iterable[Any], second: Iterable[Any], third: Iterable[Any]) -> list[Any]:
    """As `spread`, but with every pair of values of the first two, and those of the third in turn."""
    ones, others, turns = list(first), list(second), list(third)
    kept = [(a, b, turns[(i + j) % len(turns)]) for i, a in enumerate(ones) for j, b in enumerate(others)]
    return sampled(product(ones, others, turns), kept)


def combined(*axes: Iterable[Any]) -> list[tuple[Any, ...]]:
    """As `spread`, for what a test goes through by itself."""
    values = [list(axis) for axis in axes]
    return list(product(*values)) if ALL else _few(values)


def _few(values: list[list[Any]]) -> list[tuple[Any, ...]]:
    return [tuple(axis[number % len(axis)] for axis in values) for number in range(max(map(len, values)))]

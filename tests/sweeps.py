"""Cases that take long and show little more than others like them: only `make sweeps` runs them.

`make sweeps` also runs the tests that draw their examples at random, with all of their examples.
"""

from __future__ import annotations

import os
from collections.abc import Collection, Iterable
from typing import Any

import pytest

ALL = os.environ.get("LIDARCODEC_EXAMPLES") == "all"


def examples(count: int) -> int:
    """How many examples a test draws: a quarter of them, at least ten, unless LIDARCODEC_EXAMPLES is `all`."""
    return count if ALL else max(10, count // 4)


def sampled(cases: Iterable[Any], kept: Collection[Any]) -> list[Any]:
    """Cases of a parameter, or tuples for several; those not among `kept` are run by `make sweeps` alone."""
    return [case if case in kept else _swept(case) for case in cases]


def _swept(case: Any) -> Any:
    values = case if isinstance(case, tuple) else (case,)
    return pytest.param(*values, marks=pytest.mark.sweep)

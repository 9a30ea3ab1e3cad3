"""Cases that take long and show little more than others like them: only `make sweeps` runs them."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from typing import Any

import pytest


def sampled(cases: Iterable[Any], kept: Collection[Any]) -> list[Any]:
    """Cases of a parameter, or tuples for several; those not among `kept` are run by `make sweeps` alone."""
    return [case if case in kept else _swept(case) for case in cases]


def _swept(case: Any) -> Any:
    values = case if isinstance(case, tuple) else (case,)
    return pytest.param(*values, marks=pytest.mark.sweep)

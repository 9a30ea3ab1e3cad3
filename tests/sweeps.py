"""Cases that take long and show little more than others like them: only `make sweeps` runs them."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from typing import Any

import pytest


def sampled(cases: Iterable[Any], kept: Collection[Any]) -> list[Any]:
    """Cases of a parameter; those that are not among `kept` are run by `make sweeps` alone."""
    return [case if case in kept else pytest.param(case, marks=pytest.mark.sweep) for case in cases]

"""Any two of codec, shape, content, bound and intensity: frames come back as promised, or are refused before sending.

`python -m tests.fuzz.round_trips` takes all combinations, as `make fuzz` does.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations

import pytest

from lidarcodec.codecs import pcodec
from lidarcodec.errors import SettingsError
from tests.contracts.combinations import CODECS, FACTORS, SHAPES, Case, covering_cases
from tests.fuzz.round_trips import outcome
from tests.sweeps import sampled

CASES = covering_cases()
DEAR = {("riddle", "24576 columns"), ("jpeg-layered", "24576 columns")}
FEW = [
    case
    for case in CASES
    if (list(CODECS).index(case.codec) + list(SHAPES).index(case.shape)) % 3 == 0
    and (case.codec, case.shape) not in DEAR
]
"""With each codec and each shape."""
LARGE = 600
"""Packets from which on one frame has to do: the sweep takes two."""


@pytest.mark.parametrize("case", sampled(CASES, FEW), ids=lambda case: "-".join(vars(case).values()))
def test_case(case: Case) -> None:
    frames = 1 if SHAPES[case.shape] >= LARGE else 3
    if case.refused:
        with pytest.raises(SettingsError, match="bound"):
            case.check(frames)
    else:
        case.check(frames)


def test_any_two_values_meet() -> None:
    rows = [tuple(vars(case).values()) for case in CASES]
    for first, second in combinations(range(len(FACTORS)), 2):
        met = {(row[first], row[second]) for row in rows}
        assert len(met) == len(FACTORS[first]) * len(FACTORS[second])
    assert len(rows) == len(CODECS) * len(SHAPES)


def cut(compress: Callable[..., bytes]) -> Callable[..., bytes]:
    """A codec that writes all but the last byte."""
    return lambda *given: compress(*given)[:-1]


def test_a_codec_that_loses_something_does_not_hold(monkeypatch: pytest.MonkeyPatch) -> None:
    case = Case("pcodec", "29 packets", "noise", "5 cm", "lossless")
    assert outcome(case, 1) == "held"
    monkeypatch.setattr(pcodec, "compress_groups", cut(pcodec.compress_groups))
    assert outcome(case, 1).startswith("TruncatedError: ")

"""Tables between ranges and samples: monotone, filling both, and the same integers on every machine."""

from __future__ import annotations

import hashlib

import numpy as np
import pytest

from lidarcodec.codecs.canvas import MAX_VALUE
from lidarcodec.codecs.range_mapping import NAMES, check_top, mapping_of, top_of
from lidarcodec.errors import SectionError


@pytest.mark.parametrize("bits", [8, 12])
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("top", [1, 300, 40_001, MAX_VALUE])
def test_both_ways_fit(name: str, bits: int, top: int) -> None:
    mapping = mapping_of(name, bits, top)  # type: ignore[arg-type]
    peak = (1 << bits) - 1
    assert (mapping.sample[0], mapping.value[0]) == (0, 0)
    assert mapping.sample[-1] == pytest.approx(peak, abs=0.01)
    assert mapping.value[-1] == top
    assert (np.diff(mapping.value) >= 0).all()
    back = mapping.value[np.rint(mapping.sample).astype(int)]
    coarsest = int(np.diff(mapping.value).max())
    assert np.abs(back - np.arange(top + 1)).max() <= coarsest / 2 + 1


def test_what_is_near_gets_more_precision_from_sqrt_and_log() -> None:
    steps = {name: np.diff(mapping_of(name, 12, MAX_VALUE).value) for name in NAMES}
    assert set(steps["linear"].tolist()) == {16, 17}
    for name in ("log", "sqrt"):
        assert steps[name][0] < 5
        assert steps[name][-1] > 30


def test_decoders_everywhere_use_the_same_integers() -> None:
    tables = [mapping_of(name, bits, MAX_VALUE).value for name in NAMES for bits in (8, 12)]
    digest = hashlib.sha256(np.concatenate(tables).astype("<i4").tobytes()).hexdigest()[:16]
    assert digest == "00e99e9f64d0ed4c"


def test_the_farthest_return_sets_the_precision_but_for_log() -> None:
    assert top_of("linear", 40_000) == 40_000
    assert top_of("linear", 0) == 1
    assert top_of("log", 40_000) == MAX_VALUE


@pytest.mark.parametrize("top", [0, MAX_VALUE + 1, 2**32 - 1])
def test_a_top_that_no_range_reaches_is_refused(top: int) -> None:
    with pytest.raises(SectionError):
        check_top(top)

"""Tables between ranges and samples: monotone, filling both, and the same integers on every machine."""

from __future__ import annotations

import hashlib
import math
from fractions import Fraction

import numpy as np
import pytest

from lidarcodec.errors import SectionError
from lidarcodec.ranges.image.canvas import MAX_VALUE
from lidarcodec.ranges.mapping import NAMES, check_top, mapping_of, top_of

FILLING = [name for name in NAMES if name != "paper"]
"""Those that use the whole sample range."""


@pytest.mark.parametrize("bits", [8, 10, 12])
@pytest.mark.parametrize("name", FILLING)
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
    steps = {name: np.diff(mapping_of(name, 12, MAX_VALUE).value) for name in FILLING}
    assert set(steps["linear"].tolist()) == {16, 17}
    for name in ("log", "sqrt"):
        assert steps[name][0] < 5
        assert steps[name][-1] > 30


def test_decoders_everywhere_use_the_same_integers() -> None:
    tables = [mapping_of(name, bits, MAX_VALUE).value for name in FILLING for bits in (8, 12)]
    digest = hashlib.sha256(np.concatenate(tables).astype("<i4").tobytes()).hexdigest()[:16]
    assert digest == "00e99e9f64d0ed4c"


@pytest.mark.parametrize("bits", [8, 10])
def test_the_equation_of_the_paper_is_taken_as_printed(bits: int) -> None:
    """|log2(d + 1) - 5| of centimetres: what is nearer than 31 cm comes back as farther away, and half is not used."""
    mapping = mapping_of("paper", bits, MAX_VALUE)
    steps = np.array([0, 60, 155, 500, 10_000, MAX_VALUE])
    expected = np.abs(np.log2(steps / 5 + 1) - 5) * (1 << (bits - 4))
    np.testing.assert_allclose(mapping.sample[steps], expected, atol=0.05)
    assert mapping.sample.max() < 0.6 * (1 << bits)
    assert (np.diff(mapping.value) >= 0).all()
    assert (mapping.value[0], mapping.value[-1]) == (155, MAX_VALUE)
    back = mapping.value[np.rint(mapping.sample).astype(int)]
    ahead = np.arange(155, MAX_VALUE + 1)
    assert np.abs(back[ahead] / ahead - 1).max() < 0.75 / (1 << (bits - 4)) + 0.01


def test_video_decoders_everywhere_use_the_same_integers() -> None:
    tables = [mapping_of(name, bits, 40_960).value for name in NAMES for bits in (8, 10)]
    digest = hashlib.sha256(np.concatenate(tables).astype("<i4").tobytes()).hexdigest()[:16]
    assert digest == "86adbed9eff5bdf2"


def test_the_farthest_return_sets_the_precision_but_for_log() -> None:
    assert top_of("linear", 40_000) == 40_000
    assert top_of("linear", 0) == 1
    assert top_of("log", 40_000) == MAX_VALUE


@pytest.mark.parametrize("top", [0, MAX_VALUE + 1, 2**32 - 1])
def test_a_top_that_no_range_reaches_is_refused(top: int) -> None:
    with pytest.raises(SectionError):
        check_top(top)


@pytest.mark.parametrize("bits", [8, 10])
@pytest.mark.parametrize("step_um", [96, 4000])
def test_a_whole_octave_between_two_steps_is_the_farther_one(bits: int, step_um: int) -> None:
    """63 cm are 157.5 steps of 4 mm: every decoder must take the same."""
    values = mapping_of("paper", bits, 1 << 20, step_um).value[:: 1 << (bits - 4)].tolist()
    exact = (Fraction(10_000 * (2 ** (5 + octave) - 1), step_um) for octave in range(16))
    assert values == [min(math.floor(steps + Fraction(1, 2)), 1 << 20) for steps in exact]

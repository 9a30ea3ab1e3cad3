"""What codecs say about their knob: a target bitrate is kept by it."""

from __future__ import annotations

import numpy as np
import pytest

from lidarcodec.codecs import table
from lidarcodec.codecs.base import own_settings
from lidarcodec.settings import StreamSettings

STEERED = [name for name in table.names() if table.codec(name).knob is not None]


def test_codecs_without_one() -> None:
    """`raw` has nothing to turn."""
    assert set(table.names()) - set(STEERED) == {"raw"}


@pytest.mark.parametrize("name", STEERED)
def test_a_knob_goes_from_coarse_to_fine_and_fits_the_codec(name: str) -> None:
    chosen = table.codec(name)
    knob = chosen.knob
    assert knob is not None
    guess = knob.guess(knob.values)
    assert len(set(knob.values)) == len(knob.values)
    assert np.all(np.diff(guess) >= 0)
    assert guess.min() > 0
    assert (knob.setting == "max_error_m") == chosen.bounded
    for value in (knob.values[0], knob.values[-1]):
        settings = knob.with_value(StreamSettings(codec=name, target_kbps=2000), value)
        table.check(settings)
        own_settings(chosen.settings, settings)


@pytest.mark.parametrize("name", STEERED)
def test_levels_are_close_enough_to_hit_a_target_by(name: str) -> None:
    """Two steps in the lossless end are 1.6 bits apart, whatever one does; below a centimetre nothing is."""
    knob = table.codec(name).knob
    assert knob is not None
    guess = knob.guess([value for value in knob.values if knob.setting == "quality" or value >= 0.01])
    assert np.max(np.diff(np.log(guess))) < (0.55 if knob.setting == "quality" else 0.12)

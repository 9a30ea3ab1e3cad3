"""What codecs say about their knob: a target bitrate is kept by it."""

from __future__ import annotations

import numpy as np
import pytest

from lidarcodec.codecs import table
from lidarcodec.codecs.base import own_settings
from lidarcodec.errors import SettingsError
from lidarcodec.settings import StreamSettings

STEERED = [name for name in table.names() if table.codec(name).knob is not None]


def test_a_codec_without_one_refuses_a_target() -> None:
    """`raw` has nothing to turn."""
    without = set(table.names()) - set(STEERED)
    assert "raw" in without
    for name in without:
        with pytest.raises(SettingsError, match="cannot keep a target bitrate"):
            table.check(StreamSettings(codec=name, target_kbps=2000))


@pytest.mark.parametrize("name", STEERED)
def test_a_knob_goes_from_coarse_to_fine_and_fits_the_codec(name: str) -> None:
    chosen = table.codec(name)
    knob = chosen.knob
    assert knob is not None
    assert len(set(knob.values)) == len(knob.values)
    assert np.all(np.diff(knob.places(knob.values)) > 0)
    assert (knob.setting == "max_error_m") == chosen.bounded
    for value in (knob.values[0], knob.values[-1]):
        settings = knob.with_value(StreamSettings(codec=name, target_kbps=2000), value)
        table.check(settings)
        own_settings(chosen.settings, settings)


@pytest.mark.parametrize("name", ["jpeg", "h264"])
def test_a_target_takes_the_samples_that_show_most_and_what_is_set_stays(name: str) -> None:
    knob = table.codec(name).knob
    assert knob is not None
    settings = StreamSettings(codec=name, target_kbps=1000)
    assert knob.with_value(settings, 20.0).codec_settings == {"mapping": "log", knob.setting: 20.0}
    own = settings.changed(codec_settings={"mapping": "sqrt"})
    assert knob.with_value(own, 20.0).codec_settings == {"mapping": "sqrt", knob.setting: 20.0}
    localise = settings.changed(purpose="localise")
    assert "mapping" not in knob.with_value(localise, 20.0).codec_settings, "its working points were measured without"

"""What a user loses if these fail: frames after the bound or the shape changed, and a bound that is none."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from lidarcodec.codecs import table
from lidarcodec.errors import SettingsError
from lidarcodec.message import SectionType
from lidarcodec.settings import StreamSettings, settings_from
from tests.golden.test_golden import slabs, turns

FREE = 16
"""Bit of the kinds of free ranges."""


def settings(codec: str, bound: float, shape: str | None = None, **own: Any) -> StreamSettings:
    """Settings of a stream; without a shape its default."""
    given = {} if shape is None else {"shape": shape}
    return StreamSettings(codec=codec, max_error_m=bound, intensity="off", codec_settings=own, **given)


def kind_of(codec: str, data: bytes) -> int:
    """The kind of the ranges of a RANGE section."""
    return data[2] if codec == "predictive" else data[11]


@pytest.mark.parametrize("frames", [turns, slabs])
@pytest.mark.parametrize(
    ("codec", "own"),
    [("predictive", {}), ("predictive", {"motion": True, "effort": 2}), ("riddle", {}), ("riddle", {"effort": 1})],
)
def test_a_stream_may_change_its_bound_and_shape_with_any_frame(codec: str, own: dict[str, Any], frames) -> None:
    plan = [
        (0.05, None),
        (0.05, None),
        (0.0, "free"),
        (0.2, "free"),
        (0.2, "rounded"),
        (0.01, "free"),
        (0.05, "rounded"),
    ]
    encoder = table.make_encoder(settings(codec, 0.05, None, **own), 1)
    decoder = table.make_decoder(table.codec_id(codec))
    for index, frame in enumerate(frames() * 3):
        bound, shape = plan[index % len(plan)]
        encoder.apply(settings(codec, bound, shape, **own))
        (message,) = encoder.encode(frame.with_(index=index))
        (came,) = decoder.decode(message)
        np.testing.assert_array_equal(came.valid, frame.valid)
        off = np.abs(came.range.astype(int) - frame.range)
        assert 0.002 * off.max() <= bound + 1e-9
        kind = kind_of(codec, message.section(SectionType.RANGE))
        assert bool(kind & FREE) == (bound > 0 and shape != "rounded")


def test_another_shape_is_refused() -> None:
    with pytest.raises(SettingsError, match="shape"):
        settings_from({"shape": "square"})

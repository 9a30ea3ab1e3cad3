"""Operating curves: more bits never show less, and nothing that is pinned moves."""

from __future__ import annotations

import numpy as np
import pytest

from lidarcodec.codecs import table
from lidarcodec.errors import SettingsError
from lidarcodec.ratecontrol.control import pins_of
from lidarcodec.ratecontrol.curve import COARSEST_M, Pins, operating_curve
from lidarcodec.settings import StreamSettings, settings_from

STEERED = [name for name in table.names() if table.codec(name).knob is not None]
PINS = [Pins(), Pins(step=1), Pins(levels=256), Pins(levels=0), Pins(bound_m=0.01), Pins(purpose="archive"),
        Pins(purpose="localise"), Pins(purpose="detect"), Pins(step=7, purpose="localise"),
        Pins(step=7, levels=11, bound_m=0.05)]  # fmt: skip


@pytest.mark.parametrize("codec", STEERED)
@pytest.mark.parametrize("pins", PINS)
def test_more_bits_never_show_less(codec: str, pins: Pins) -> None:
    curve = operating_curve(codec, pins)
    assert len(curve.points) >= 1
    assert np.all(np.diff(curve.bits) > 0)
    assert np.all(np.diff(curve.cost) < 0)
    assert np.all(np.diff(curve.chamfer_m) <= 0)
    assert np.all(np.diff(curve.shades) <= 0)
    assert np.all(np.diff([point.step for point in curve.points]) <= 0)


@pytest.mark.parametrize("codec", STEERED)
def test_what_is_pinned_stays(codec: str) -> None:
    bounded = table.codec(codec).bounded
    assert {point.step for point in operating_curve(codec, Pins(step=7)).points} == {7}
    assert {point.levels for point in operating_curve(codec, Pins(levels=11)).points} == {11}
    assert {point.step for point in operating_curve(codec, Pins(purpose="archive")).points} == {1}
    if bounded:
        assert max(point.value for point in operating_curve(codec, Pins()).points) <= COARSEST_M
        assert max(point.value for point in operating_curve(codec, Pins(bound_m=0.02)).points) == 0.02
        assert operating_curve(codec, Pins()).points[-1].value == 0.0, "with bits enough all is exact"


@pytest.mark.parametrize("codec", ["riddle", "predictive", "pcodec", "zstd"])
def test_a_mobile_link_gets_a_picture_and_a_good_one_gets_all(codec: str) -> None:
    """Of 123,000 returns ten times a second."""
    curve = operating_curve(codec, Pins())
    kbps = curve.bits * 1230
    assert kbps[0] < 300
    assert curve.points[-1].levels == 256
    gaps = np.diff(np.log(kbps))
    assert np.max(gaps[kbps[1:] < 6000]) < 0.12, "no gap in which a target cannot be kept"
    assert np.max(gaps) < 0.25, "from 2 mm to exact ranges is the widest"


def test_what_settings_leave_free_is_free() -> None:
    assert pins_of(StreamSettings(codec="riddle", target_kbps=1000)) == Pins()
    assert pins_of(StreamSettings(codec="riddle", intensity="lossless", reduction="all", max_error_m=0.02)) == Pins(
        1, 256, 0.02
    )
    assert pins_of(StreamSettings(codec="riddle", reduction="lattice:6", intensity="levels=9")) == Pins(6, 9)
    assert pins_of(StreamSettings(codec="jpeg", codec_settings={"quality": 60}, reduction="voxel")) == Pins(
        1, value=60.0, sparse=True
    )
    assert not pins_of(StreamSettings(codec="jpeg", reduction="lattice:4")).sparse
    assert pins_of(StreamSettings(codec="jpeg", reduction="lattice:4", purpose="localise")).sparse
    with pytest.raises(SettingsError, match="purpose"):
        settings_from({"purpose": "fun"})

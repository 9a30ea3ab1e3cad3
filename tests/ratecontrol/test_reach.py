"""Without these words an operator sees two frames a second and does not know what keeps the stream from its target."""

from __future__ import annotations

import pytest

from lidarcodec.ratecontrol.reach import columns_warning, in_the_way, missed_warning, reach_warning
from lidarcodec.settings import StreamSettings

PINNED = StreamSettings(codec="riddle", target_kbps=1000, max_error_m=0, intensity="lossless", reduction="all")


def rate(**values: object) -> dict[str, object]:
    """The `rate` of a status, of a stream that keeps its target."""
    told = {"auto": False, "target_kbps": 1000.0, "reachable_kbps": [300.0, 9000.0], "limited_by": "target"}
    return told | {"reached": True, "kbps_5s": 1010.0} | values


@pytest.mark.parametrize(
    ("settings", "names"),
    [
        ({"reduction": "all", "intensity": "off"}, ("reduction",)),
        ({"reduction": "all", "intensity": "lossless"}, ("intensity", "reduction")),
        ({"purpose": "archive"}, ("purpose",)),
        ({"max_error_m": 0.3}, ()),
        ({"codec": "jpeg", "codec_settings": {"quality": 95}}, ("codec_settings.quality",)),
        ({"reduction": "voxel"}, ("reduction",)),
        ({}, ()),
    ],
)
def test_only_settings_that_are_in_the_way_are_named(settings, names):
    assert in_the_way(StreamSettings(**({"codec": "riddle", "target_kbps": 300} | settings))) == names


def test_before_anything_was_measured_the_settings_say_what_is_expected():
    warning = reach_warning(PINNED)
    assert warning is not None
    assert warning == missed_warning(PINNED, None) == missed_warning(PINNED, {"reachable_kbps": None})
    assert (warning.code, warning.asked_kbps, warning.sent_kbps) == ("target_out_of_reach", 1000, None)
    assert warning.needed_kbps > 5000
    assert warning.remedy.startswith("set max_error_m, intensity and reduction back, which needs about ")


def test_what_is_measured_counts_and_not_what_was_expected():
    assert missed_warning(PINNED, rate()) is None
    missed = missed_warning(PINNED, rate(kbps_5s=4575.0, limited_by="floor", reachable_kbps=[4500.0, 4600.0]))
    assert missed is not None
    assert missed.code == "target_missed"
    assert missed.message.startswith(
        "1,000 kbit/s are asked for, 4,575 are sent; every frame takes 4,500 with max_error_m"
    )
    assert (missed.asked_kbps, missed.sent_kbps, missed.needed_kbps) == (1000.0, 4575.0, 4500.0)


def test_a_target_that_is_kept_by_leaving_out_frames_is_said_so():
    archive = StreamSettings(codec="riddle", target_kbps=500, purpose="archive")
    told = rate(target_kbps=500.0, kbps_5s=500.0, limited_by="floor", reachable_kbps=[800.0, 9000.0])
    floor = missed_warning(archive, told)
    assert floor is not None
    assert (floor.code, floor.settings) == ("frames_left_out", ("purpose",))
    assert floor.remedy.endswith("or set a target of 800 kbit/s or more")


def test_settings_that_cost_most_columns_are_named():
    """A picture of every 13th column came without a word of what had made it so."""
    pins = StreamSettings(codec="pcodec", target_kbps=1000, max_error_m=0.01, intensity="lossless")
    told = rate(target_kbps=1000.0, kbps_5s=1000.0, limited_by="target", reachable_kbps=[640.0, 8400.0], step=13)
    few = missed_warning(pins, told)
    assert few is not None
    assert (few.code, few.settings) == ("columns_left_out", ("max_error_m", "intensity")), "neither alone is enough"
    assert few.message == "the 1,000 kbit/s carry only every 13th column with max_error_m and intensity as set"
    assert few.remedy.startswith("set max_error_m and intensity back, then about every 4th column is sent, or set a ")
    assert few.needed_kbps is not None
    assert few.needed_kbps > 8000
    one = missed_warning(pins, told | {"step": 16})
    assert one is not None
    assert one.settings == ("intensity",)
    assert missed_warning(pins, told | {"step": 6}) is None
    expected = columns_warning(pins)
    assert expected is not None
    assert (expected.code, "intensity" in expected.settings) == (few.code, True), "who sets them is told at once"
    for well in (pins.changed(target_kbps=6000), pins.changed(max_error_m=None, intensity="auto"), PINNED):
        assert columns_warning(well) is None
    free = StreamSettings(codec="pcodec", target_kbps=1000)
    assert missed_warning(free, told | {"step": 16}) is None, "nothing was pinned"


def test_a_path_that_carries_too_little_is_no_fault_of_the_target():
    auto = StreamSettings(codec="riddle", target_kbps="auto", intensity="lossless")
    assert missed_warning(auto, None) is None
    assert missed_warning(auto, rate(auto=True, kbps_5s=2000.0)) is None, "it is compared with no mean"
    floor = missed_warning(auto, rate(auto=True, limited_by="floor"))
    assert floor is not None
    assert "1,000 kbit/s that the path carries" in floor.message
    assert "better path" in floor.remedy


@pytest.mark.parametrize(
    "told", [rate(kbps_5s=400.0, limited_by="codec", reached=False), {"reachable_kbps": [1.0, 2.0]}]
)
def test_less_than_was_asked_for_or_nothing_that_was_told_is_no_alarm(told):
    assert missed_warning(PINNED.changed(target_kbps=20_000), told) is None


@pytest.mark.parametrize("settings", [StreamSettings(codec="raw"), StreamSettings(codec="riddle")])
def test_without_a_target_there_is_nothing_to_miss(settings):
    assert missed_warning(settings, rate(limited_by="floor")) is None

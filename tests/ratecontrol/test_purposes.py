"""`localise` and `detect`: to a target what says most to a program, and no intensity unless it is asked for."""

from __future__ import annotations

import json
from importlib.resources import files

import numpy as np
import pytest

from benchmarks.things import frames_with_things, missed_m
from lidarcodec import filled
from lidarcodec.codecs import table
from lidarcodec.pipeline import StreamDecoder, StreamEncoder
from lidarcodec.ratecontrol.curve import Pins, operating_curve
from lidarcodec.ratecontrol.reach import reach_warning
from lidarcodec.settings import StreamSettings, settings_from
from lidarcodec.wire import size_of
from tests.sweeps import sampled

PURPOSES = ("localise", "detect")
STEERED = [name for name in table.names() if table.codec(name).knob is not None]
BOUNDED = [name for name in STEERED if table.codec(name).bounded]


@pytest.fixture(scope="module")
def town():
    """Frames of a simulated town that no curve was made of, each with the things in it."""
    return frames_with_things("sim:city?seed=9&skip=30", 16)


def sent(frames, **settings):
    """Kilobits a second behind the first six frames, and all frames as decoded."""
    encoder, decoder = StreamEncoder(settings_from(settings), stream_id=1), StreamDecoder()
    sizes, decoded = [], []
    for frame in frames:
        messages = encoder.encode(frame)
        assert not encoder.left_out
        sizes.append(sum(map(size_of, messages)))
        decoded += [back for message in messages for back in decoder.decode(message)]
    return 8 * np.mean(sizes[6:]) / 100, decoded, encoder


@pytest.mark.parametrize("codec", STEERED)
@pytest.mark.parametrize("purpose", PURPOSES)
def test_every_codec_has_a_curve_on_which_more_bits_never_show_less(codec, purpose):
    for pins in (Pins(purpose=purpose), Pins(levels=256, purpose=purpose), Pins(bound_m=0.02, purpose=purpose)):
        curve = operating_curve(codec, pins)
        assert np.all(np.diff(curve.bits) > 0)
        assert np.all(np.diff(curve.cost) < 0)
        assert {point.levels for point in curve.points} == {pins.levels or 0}
        if codec in BOUNDED:
            assert max(point.value for point in curve.points) <= (pins.bound_m or 0.3)
    assert {point.step for point in operating_curve(codec, Pins(step=1, purpose=purpose)).points} == {1}


@pytest.mark.parametrize("codec", ["riddle", "predictive", "pcodec", "zstd"])
@pytest.mark.parametrize("purpose", PURPOSES)
def test_a_weak_mobile_link_carries_every_frame_and_there_is_no_gap(codec, purpose):
    kbps = operating_curve(codec, Pins(purpose=purpose)).bits * 1100
    assert kbps[0] < 300
    assert np.max(np.diff(np.log(kbps[kbps < 3000]))) < 0.25
    assert reach_warning(StreamSettings(codec=codec, target_kbps=300, purpose=purpose)) is None


@pytest.mark.parametrize(
    ("codec", "target"),
    sampled([("riddle", 500), ("pcodec", 800), ("predictive", 400), ("zstd", 1000)], [("pcodec", 800)]),
)
@pytest.mark.parametrize("purpose", PURPOSES)
def test_the_target_is_kept_and_every_return_is_measured(town, purpose, codec, target):
    frames = [frame for frame, _ in town]
    kbps, decoded, encoder = sent(frames, codec=codec, target_kbps=target, purpose=purpose)
    assert 0.85 * target < kbps < 1.15 * target
    assert encoder.rate["intensity"] == "off"
    for frame, back in zip(frames, decoded, strict=True):
        there = back.range > 0
        assert (frame.range[there] > 0).all()
        off = np.abs(frame.range[there].astype(int) - back.range[there]) * 0.002
        assert off.max() <= {"localise": 0.1, "detect": 0.3}[purpose] + 1e-9
    if purpose == "localise":
        told = encoder.reduction
        assert told["name"] == "voxel-seen"
        assert told["kept"] == decoded[-1].points < 0.5 * frames[-1].points
        assert encoder.rate["step"] == 1, "no columns are left out"
        assert filled(decoded[-1]) is decoded[-1], "there is nothing between which to make something up"
    else:
        assert encoder.rate["step"] > 1


@pytest.mark.sweep
def test_a_detector_gets_more_of_the_things_around_than_a_viewer(town):
    frames = [frame for frame, _ in town]
    missed = {}
    for purpose in ("look", "detect"):
        _, decoded, _ = sent(frames, codec="predictive", target_kbps=600, purpose=purpose)
        missed[purpose] = np.mean([missed_m(things, back) for (_, things), back in zip(town, decoded, strict=True)][6:])
    assert missed["detect"] < missed["look"]


def test_what_is_set_is_kept_whatever_the_purpose(town):
    frames = [frame for frame, _ in town]
    given = {"codec": "predictive", "target_kbps": 1500, "purpose": "localise"}
    _, decoded, encoder = sent(frames, **given, reduction="voxel", keep_points=5000)
    assert {back.points for back in decoded} == {5000}
    assert encoder.reduction["name"] == "voxel"
    _, decoded, encoder = sent(frames, **given, intensity="lossless")
    assert encoder.reduction["name"] == "voxel-seen"
    there = decoded[-1].range > 0
    assert encoder.rate["intensity"] == "lossless"
    assert (decoded[-1].intensity[there] == frames[-1].intensity[there]).all()


def test_the_purpose_changes_between_two_frames(town):
    encoder, decoder = StreamEncoder(StreamSettings(codec="predictive", target_kbps=800), stream_id=1), StreamDecoder()
    names = []
    for number, (frame, _) in enumerate(town):
        if number % 4 == 0:
            encoder.apply(encoder.settings.changed(purpose=("look", "localise", "detect", "archive")[number // 4]))
        for message in encoder.encode(frame):
            (back,) = decoder.decode(message)
            assert back.index == frame.index
        names.append(None if encoder.reduction is None else encoder.reduction["name"])
    assert names == [None] * 4 + ["voxel-seen"] * 4 + [None] * 8


def test_without_a_target_everything_is_sent(town):
    for purpose in PURPOSES:
        encoder = StreamEncoder(StreamSettings(codec="zstd", purpose=purpose), stream_id=1)
        encoder.encode(town[0][0])
        assert encoder.reduced.keep is None
        assert encoder.reduction is None


def test_things_were_measured_at_every_step_of_the_lattice():
    """A step that only the other purposes knew ended every stream for a detector: "10 is not in list"."""
    folder = files("lidarcodec.ratecontrol")
    things = json.loads(folder.joinpath("working_points_detect.json").read_text())
    for entry in json.loads(folder.joinpath("working_points.json").read_text()).values():
        assert set(entry["steps"]) <= set(things["steps"])


@pytest.mark.parametrize("codec", BOUNDED)
@pytest.mark.parametrize("purpose", [*PURPOSES, "look", "archive"])
@pytest.mark.parametrize("bound_m", [0.0, 0.002])
def test_a_bound_that_is_set_holds_though_it_is_finer_than_what_was_measured(codec, purpose, bound_m):
    """`localise` took the finest bound that was measured, 4 mm: a stream that was asked to be exact was not."""
    curve = operating_curve(codec, Pins(bound_m=bound_m, purpose=purpose))
    assert max(point.value for point in curve.points) <= bound_m


def test_what_is_set_to_be_exact_is_exact_for_a_localiser(town):
    frames = [frame for frame, _ in town]
    _, decoded, _ = sent(frames, codec="pcodec", purpose="localise", max_error_m=0.0, target_kbps=20000)
    for frame, back in zip(frames, decoded, strict=True):
        assert (back.range[back.valid] == frame.range[back.valid]).all()

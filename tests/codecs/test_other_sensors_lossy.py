"""What a user of another sensor than an HDL-64E would lose beyond what was asked for: attributes, returns, a bound."""

from __future__ import annotations

import random
from collections import Counter
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from lidarcodec import wire
from lidarcodec.assembly import packets_of
from lidarcodec.codecs.other_sensors import KINDS
from lidarcodec.errors import DecodeError
from lidarcodec.evaluation.round_trip import RoundTrip
from lidarcodec.evaluation.verify import promise_of
from lidarcodec.filling import filled, made_up, measured_only
from lidarcodec.frame import Frame
from lidarcodec.frame_images import images_of, layout_of
from lidarcodec.message import Message
from lidarcodec.pipeline import StreamDecoder, StreamEncoder, frames_of
from lidarcodec.planes.attribute_values import scale_of
from lidarcodec.sensors.images import QUANTITIES, PacketLayout, Unsigned
from lidarcodec.settings import settings_from
from tests.codecs.test_other_sensors import FILES, SMALL, opened, used
from tests.fuzz.mutations import mutated
from tests.sweeps import examples, paired

REDUCTIONS = ("columns:3", "lattice:3", "lattice:64", "random", "voxel", "voxel-seen")
WIDE = "OS-1-64_1024x10_fw20"
"""An Ouster with attributes of 16 bits that reach 64,708."""


def framed(capture: str, packets: int = 24) -> tuple[Frame, PacketLayout]:
    """A short frame of a capture."""
    sensor, of = opened(FILES[capture])
    frame = next(iter(frames_of(of[:packets], sensor, f"packets:{packets}")))
    found = layout_of(frame)
    assert found is not None
    return frame, found[1]


def there_and_back(frame: Frame, settings: dict[str, object]) -> tuple[Frame, Message, Frame]:
    """The frame as it was encoded, its message, and what a receiver has; compared as recordings are."""
    wanted = settings_from({"codec": "predictive", **settings})
    encoder, check = StreamEncoder(wanted, 7), RoundTrip(wanted)
    (message,) = encoder.encode(frame)
    assert encoder.reduced is not None
    check.sent(encoder.reduced)
    (decoded,) = check.message(wire.pack(message))
    return encoder.reduced, message, decoded


def all_planes(frame: Frame, layout: PacketLayout) -> dict[str, Unsigned]:
    return images_of(frame, layout).planes


@pytest.mark.parametrize(("capture", "codec", "error"), paired([*SMALL, WIDE], KINDS, [1, 6, 127]))
def test_an_error_of_attributes_is_kept_at_every_return(capture: str, codec: str, error: int) -> None:
    frame, layout = framed(capture)
    _, message, decoded = there_and_back(frame, {"codec": codec, "intensity": f"error={error}"})
    before, after = all_planes(frame, layout), all_planes(decoded, layout)
    for form in layout.planes:
        if form.role != "attribute":
            np.testing.assert_array_equal(after[form.name], before[form.name])
            continue
        returns = before[form.of] > 0
        assert not after[form.name][~returns].any()
        given, came = before[form.name][returns], after[form.name][returns]
        if form.name.removesuffix("2") not in QUANTITIES:
            np.testing.assert_array_equal(came, given)
            continue
        off = np.abs(scale_of(came, form.bits) - scale_of(given, form.bits))
        assert off.max(initial=0) <= error + 1e-6
    assert not promise_of(message).identical


@pytest.mark.parametrize("levels", [2, 3, 16, 255])
@pytest.mark.parametrize("capture", [*SMALL, WIDE])
def test_levels_leave_no_more_values_and_the_mean_stays(capture: str, levels: int) -> None:
    frame, layout = framed(capture)
    _, _, decoded = there_and_back(frame, {"intensity": f"levels={levels}"})
    before, after = all_planes(frame, layout), all_planes(decoded, layout)
    for form in layout.planes:
        if form.name in QUANTITIES:
            alike = [one for one in layout.planes if one.name.removesuffix("2") == form.name]  # second returns, too
            given, came = (
                np.concatenate([planes[one.name][before[one.of] > 0] for one in alike]).astype(float)
                for planes in (before, after)
            )
            assert len(np.unique(came)) <= levels
            assert abs(came.mean() - given.mean()) <= 0.5
            assert np.square(came - given).mean() <= given.var() + 0.25


def test_more_levels_are_never_worse_and_256_is_lossless() -> None:
    frame, _ = framed("vlp16")
    errors, sizes = [], []
    for levels in (2, 4, 8, 16, 32, 64, 256):
        _, message, decoded = there_and_back(frame, {"intensity": f"levels={levels}"})
        off = decoded.intensity.astype(float) - frame.intensity
        errors.append(float(np.square(off[frame.valid]).mean()))
        sizes.append(len(wire.pack(message)))
    assert all(one >= other for one, other in pairwise(errors))
    assert sizes[0] < sizes[-1]
    assert errors[-1] == 0
    assert promise_of(message).identical
    assert [one.payload for one in packets_of(decoded)] == [one.payload for one in packets_of(frame)]


@pytest.mark.parametrize("codec", KINDS)
@pytest.mark.parametrize("reduction", REDUCTIONS)
def test_a_dropped_return_is_none_in_all_planes(reduction: str, codec: str) -> None:
    for capture in SMALL:
        frame, layout = framed(capture)
        sent, message, decoded = there_and_back(frame, {"codec": codec, "reduction": reduction})
        assert sent.keep is not None
        assert 0 < decoded.points < frame.points
        before, after = all_planes(frame, layout), all_planes(decoded, layout)
        for name, image in before.items():
            np.testing.assert_array_equal(after[name], np.where(sent.keep, image, 0))
        promise = promise_of(message)
        assert (promise.identical, promise.reduced) == (False, True)
        assert len(packets_of(decoded)) == len(packets_of(frame))
        np.testing.assert_array_equal(decoded.azimuth, frame.azimuth)
        if reduction.startswith("lattice"):
            np.testing.assert_array_equal(decoded.lattice, sent.lattice)


@pytest.mark.parametrize("reduction", ["random", "voxel"])
@pytest.mark.parametrize(
    "budget", [{"keep_points": 1}, {"keep_points": 500}, {"keep_fraction": 0.25}, {"keep_fraction": 1}]
)
@pytest.mark.parametrize("capture", ["vlp16", "OS-2-128-U1_v2.3.0_1024x10"])
def test_a_budget_is_met_to_the_return(capture: str, reduction: str, budget: dict[str, float]) -> None:
    frame, _ = framed(capture)
    _, _, decoded = there_and_back(frame, {"reduction": reduction, **budget})
    points = budget.get("keep_points", int(budget.get("keep_fraction", 1) * frame.points + 0.5))
    assert decoded.points == points


def test_a_reduction_a_bound_and_few_values_go_together() -> None:
    for capture in SMALL:
        frame, layout = framed(capture)
        settings = {"reduction": "lattice:4", "max_error_m": 0.1, "intensity": "levels=4"}
        sent, message, decoded = there_and_back(frame, settings)
        before, after = all_planes(sent, layout), all_planes(decoded, layout)
        for form in layout.planes:
            if form.role != "attribute":
                off = np.abs(after[form.name].astype(np.int64) - before[form.name])
                assert off.max() * frame.sensor.range_step_m <= 0.1
        (again,) = StreamEncoder(settings_from({"codec": "predictive", **settings}), 7).encode(frame)
        assert wire.pack(again) == wire.pack(message)


@pytest.mark.parametrize("name", ["poconet", "poconet-paper"])
@pytest.mark.parametrize("capture", [*SMALL, WIDE])
def test_a_network_chooses_returns_of_any_number_of_rows(capture: str, name: str) -> None:
    pytest.importorskip("onnxruntime", reason="the extra `poconet`")
    frame, layout = framed(capture)
    sent, _, decoded = there_and_back(frame, {"reduction": name, "keep_fraction": 0.25})
    assert sent.keep is not None
    assert decoded.points == int(0.25 * frame.points + 0.5)
    before, after = all_planes(frame, layout), all_planes(decoded, layout)
    for plane, image in before.items():
        np.testing.assert_array_equal(after[plane], np.where(sent.keep, image, 0))


@pytest.mark.drawn
@pytest.mark.parametrize("settings", [{"intensity": "levels=5"}, {"reduction": "lattice:4", "intensity": "error=9"}])
@pytest.mark.parametrize("capture", SMALL)
def test_damaged_messages_are_decode_errors(capture: str, settings: dict[str, object]) -> None:
    frame, _ = framed(capture, 12)
    _, message, _ = there_and_back(frame, settings)
    rng, found = random.Random(4), Counter[bool]()
    for _ in range(examples(100)):
        at = rng.randrange(len(message.sections))
        sections = list(message.sections)
        sections[at] = sections[at]._replace(data=mutated(sections[at].data, rng))
        width = rng.choice((message.width, message.width, 0, message.width - 1))
        try:
            used(wire.unpack(wire.pack(replace(message, sections=tuple(sections), width=width))))
            found[True] += 1
        except DecodeError:
            found[False] += 1
    assert found[False] > 0.3 * examples(100)


def test_a_frame_without_returns_can_have_few_values() -> None:
    frame, layout = framed("vlp16")
    nothing = {name: np.zeros_like(image) for name, image in frame.planes.items()}
    empty = frame.with_(range=np.zeros_like(frame.range), planes=nothing)
    for settings in ({"intensity": "levels=2"}, {"intensity": "error=9"}, {"reduction": "voxel"}):
        _, _, decoded = there_and_back(empty, settings)
        assert not any(image.any() for image in all_planes(decoded, layout).values()) or settings == {
            "reduction": "voxel"
        }
        assert not decoded.points
    assert StreamDecoder().flush() == []


@pytest.mark.parametrize("capture", [*SMALL, "OS-2-128-U1_v2.3.0_1024x10"])
def test_what_a_receiver_fills_in_is_marked_and_can_be_taken_out(capture: str) -> None:
    frame, layout = framed(capture)
    _, _, decoded = there_and_back(frame, {"reduction": "lattice:4"})
    shown = filled(decoded)
    assert shown.filled is not None
    assert shown.filled.any()
    assert decoded.lattice is not None
    assert not shown.filled[:, decoded.lattice].any()
    assert shown.points == decoded.points + np.count_nonzero(shown.filled)
    assert np.count_nonzero(made_up(shown)) == np.count_nonzero(shown.filled)
    assert len(shown.cloud()) == shown.points
    for name, image in all_planes(shown, layout).items():
        if name.endswith("2"):
            assert not image[shown.filled].any()  # no second return is made up
    for name, image in all_planes(measured_only(shown), layout).items():
        np.testing.assert_array_equal(image, all_planes(decoded, layout)[name])
    assert [one.payload for one in packets_of(shown)] == [one.payload for one in packets_of(decoded)]
    between = shown.filled[:, :-8]
    off = np.abs(shown.range[:, :-8].astype(float) - frame.range[:, :-8])[between & (frame.range[:, :-8] > 0)]
    assert np.median(off) * frame.sensor.range_step_m < 0.25

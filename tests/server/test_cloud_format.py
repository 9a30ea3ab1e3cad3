"""The bytes that a viewer gets are the frame's points, whoever reads them by the description."""

from __future__ import annotations

import numpy as np
import pytest

from lidarcodec import filled, read_frames
from lidarcodec.sensors import generic_sensor
from lidarcodec_server.live.cloud_format import STEP_M, Facts, packed, sensor_facts
from lidarcodec_server.live.options import CloudOptions, Encoding
from tests.contracts.frames import received
from tests.server.live import client_module

CLIENT = client_module()
FACTS = Facts(stream_id=2**63 + 5, codec=3, missing=7, latency_ms=12.5, decoded_ns=1_700_000_000_123_456_789)
ALL = Encoding("points", ("intensity", "ring", "range"), None)


@pytest.fixture(scope="module")
def frame():
    return next(read_frames("sim:city?frames=1"))


def test_points_are_those_of_the_cloud_within_half_a_step(frame):
    head, arrays = CLIENT.read_message(packed(frame, FACTS, ALL))
    cloud = frame.cloud()
    points = CLIENT.points_of(head, arrays)
    for number, axis in enumerate("xyz"):
        assert np.abs(points[:, number] - cloud[axis]).max() <= STEP_M / 2 + 1e-4
    assert np.array_equal(arrays["intensity"], cloud["intensity"])
    assert np.array_equal(arrays["ring"], cloud["ring"])
    assert np.array_equal(arrays["range"], frame.range.T[frame.valid.T])


def test_the_header_says_what_the_frame_does_not(frame):
    head, _ = CLIENT.read_message(packed(frame, FACTS._replace(latency_ms=None), ALL))
    assert (head["stream_id"], head["codec"], head["missing"]) == (FACTS.stream_id, 3, 7)
    assert (head["frame_index"], head["stamp_ns"]) == (frame.index, frame.stamp_ns)
    assert head["decoded_ns"] == FACTS.decoded_ns
    assert np.isnan(head["latency_ms"])
    assert head["count"] == head["returns"] == np.count_nonzero(frame.valid)


@pytest.mark.parametrize("form", ["points", "range"])
def test_every_array_begins_where_a_graphics_card_can_take_it(frame, form):
    for count in (1, 2, 3, 5):
        wanted = Encoding(form, ("intensity",), count if form == "points" else None)
        data = packed(frame, FACTS, wanted)
        head, arrays = CLIENT.read_message(data)
        start = np.frombuffer(data, np.uint8).__array_interface__["data"][0]
        places = [array.__array_interface__["data"][0] - start for array in arrays.values()]
        assert head["header_bytes"] == places[0] == 96
        assert all(place % 4 == 0 for place in places)
        assert len(data) % 4 == 0


def test_max_points_keeps_points_of_the_whole_turn(frame):
    head, arrays = CLIENT.read_message(packed(frame, FACTS, Encoding("points", (), 5000)))
    assert (head["count"], head["flags"]) == (5000, 8)
    assert head["returns"] == np.count_nonzero(frame.valid)
    directions = np.degrees(np.arctan2(arrays["y"].astype(float), arrays["x"]))
    assert np.histogram(directions, 12, (-180, 180))[0].min() > 50


@pytest.mark.parametrize("model", ["S2", "S3"])
@pytest.mark.parametrize("convention", ["ros", "veloview"])
def test_a_range_image_and_the_sensor_event_give_the_same_points(frame, model, convention):
    sensor = generic_sensor(f"HDL-64E {model}").with_convention(convention)
    told = frame.with_(sensor=sensor)
    head, arrays = CLIENT.read_message(packed(told, FACTS, Encoding("range", ("intensity",), None)))
    points = CLIENT.points_of_range(head, arrays, sensor_facts(sensor))
    cloud = told.cloud()
    order = np.lexsort(np.nonzero(told.valid))  # the image goes row by row, the cloud column by column
    expected = np.stack([cloud[axis] for axis in "xyz"], axis=1)
    assert np.abs(points[order] - expected).max() < 1e-4


def test_what_a_reducer_left_out_is_in_neither_form(frame):
    keep = np.zeros(frame.range.shape, bool)
    keep[:, ::2] = True
    reduced = frame.with_(keep=keep)
    for form in ("points", "range"):
        head, arrays = CLIENT.read_message(
            packed(reduced, FACTS, Encoding(form, ("range",) * (form == "points"), None))
        )
        assert np.count_nonzero(arrays["range"]) == head["count"] == np.count_nonzero(reduced.valid)


def test_an_empty_frame_and_the_longest_ranges_are_sent_whole(frame):
    none = frame.with_(range=np.zeros_like(frame.range))
    assert CLIENT.read_message(packed(none, FACTS, ALL))[0]["count"] == 0
    far = frame.with_(range=np.full_like(frame.range, 65535))
    head, arrays = CLIENT.read_message(packed(far, FACTS, ALL))
    cloud = far.cloud()
    points = CLIENT.points_of(head, arrays)
    assert head["scale_m"] >= STEP_M * 0.999
    for number, axis in enumerate("xyz"):
        assert np.abs(points[:, number] - cloud[axis]).max() <= head["scale_m"] / 2 + 1e-4


def test_options_are_read_as_a_whole_or_refused_by_name():
    options = CloudOptions.of({"attributes": "ring,intensity", "max_points": "10", "rate": "5", "window": "2"})
    assert (options.encoding, options.rate, options.window) == (Encoding("points", ("intensity", "ring"), 10), 5.0, 2)
    assert CloudOptions.of({"form": "range"}).encoding == Encoding("range", ("intensity", "filled"), None, fill=True)
    assert CloudOptions.of({"attributes": ""}).encoding.attributes == ()


def test_the_pose_of_a_frame_comes_with_it_and_readers_that_know_none_are_not_confused(frame):
    pose = np.eye(4)
    pose[:3, :3] = [[0.8, -0.6, 0.0], [0.6, 0.8, 0.0], [0.0, 0.0, 1.0]]
    pose[:3, 3] = [4_000_000.125, -17.5, 2.25]
    for form in ("points", "range"):
        wanted = Encoding(form, ("intensity",), None)
        data = packed(frame.with_(pose=pose), FACTS, wanted)
        head, arrays = CLIENT.read_message(data)
        assert (head["header_bytes"], head["flags"]) == (192, 1 | 32)
        assert np.array_equal(np.frombuffer(data, "<f8", 12, 96).reshape(3, 4), pose[:3])
        plain = CLIENT.read_message(packed(frame, FACTS, wanted))[1]
        assert all(np.array_equal(arrays[name], plain[name]) for name in plain)


@pytest.fixture(scope="module")
def thinned(frame):
    """Every eighth column of it, as a receiver has it."""
    return received(frame, "lattice:8")


@pytest.mark.parametrize("form", ["points", "range"])
def test_what_is_made_up_is_marked_and_not_counted_as_measured(thinned, form):
    whole = filled(thinned)
    head, arrays = CLIENT.read_message(packed(thinned, FACTS, CloudOptions.of({"form": form}).encoding))
    assert head["flags"] & (64 | 128) == 64 | 128
    assert head["returns"] == np.count_nonzero(thinned.range)
    assert head["count"] == np.count_nonzero(whole.range) > 4 * head["returns"]
    made_up = whole.filled.ravel() if form == "range" else whole.filled.T[whole.valid.T]
    assert np.array_equal(arrays["filled"], made_up)
    head, arrays = CLIENT.read_message(packed(thinned, FACTS, CloudOptions.of({"form": form, "fill": "0"}).encoding))
    assert (head["flags"] & (64 | 128), head["count"]) == (0, head["returns"])
    assert "filled" not in arrays


def test_what_is_made_up_of_another_sensor_is_marked_in_its_order():
    thinned = received(next(read_frames("sim:city?frames=1&sensor=vlp16")), "lattice:3")
    whole, wanted = filled(thinned), CloudOptions.of({}).encoding
    made_up = whole.filled.T[whole.valid.T]
    head, arrays = CLIENT.read_message(packed(thinned, FACTS, wanted))
    assert head["count"] == len(whole.cloud()) > 2 * head["returns"]
    assert np.array_equal(arrays["filled"], made_up)
    assert np.array_equal(arrays["ring"], whole.cloud()["ring"])
    fewer = CLIENT.read_message(packed(thinned, FACTS, wanted._replace(max_points=100)))[1]
    assert len(fewer["filled"]) == len(fewer["x"]) == 100


def test_a_frame_that_was_not_thinned_costs_no_byte_more_for_the_marks(frame):
    marked, plain = (Encoding("range", names, None) for names in (("intensity", "filled"), ("intensity",)))
    assert packed(frame, FACTS, marked) == packed(frame, FACTS, plain)


def test_an_original_is_sent_beside_its_frame_or_not_at_all(frame):
    wanted = CloudOptions.of({"form": "range", "attributes": "original,intensity"}).encoding
    coarse = frame.with_(range=(frame.range // 8 * 8).astype(np.uint16))
    head, arrays = CLIENT.read_message(packed(coarse, FACTS, wanted, frame.range_u16))
    assert head["flags"] == 1 | 16
    assert np.array_equal(arrays["range"], coarse.range.ravel())
    assert np.array_equal(arrays["original"], frame.range.ravel())
    for missing in (None, frame.range_u16[:, 1:]):
        head, arrays = CLIENT.read_message(packed(coarse, FACTS, wanted, missing))
        assert head["flags"] == 1
        assert "original" not in arrays

"""Average precision: codecs are compared by it, so a wrong figure would make a user choose the wrong one."""

from __future__ import annotations

from io import BytesIO

import numpy as np
import pytest

from lidarcodec.errors import SourceError
from lidarcodec.evaluation.detection.boxes import upright
from lidarcodec.evaluation.detection.detector.network import LAYERS, SHIPPED, Layer, Network, read_network
from lidarcodec.evaluation.detection.detector.objects import NONE, Found, found_in
from lidarcodec.evaluation.detection.detector.overlap import overlaps
from lidarcodec.evaluation.detection.detector.precision import Precision, precisions
from lidarcodec.evaluation.detection.detector.view import CELLS, CHANNELS, DEPTH_M, seen
from lidarcodec.evaluation.detection.evaluate import Detection
from lidarcodec.untrusted.network_weights import packed


@pytest.mark.sweep
def test_overlaps_of_turned_boxes_are_those_of_fine_grids() -> None:
    rng = np.random.default_rng(3)
    boxes = np.stack(
        [
            rng.uniform(-2, 2, 40),
            rng.uniform(-2, 2, 40),
            rng.uniform(1, 5, 40),
            rng.uniform(1, 2, 40),
            rng.uniform(-9, 9, 40),
        ],
        axis=-1,
    )
    steps = np.arange(-5, 5, 0.02)
    x, y = np.meshgrid(steps, steps)
    c, s = np.cos(boxes[:, 4])[:, None, None], np.sin(boxes[:, 4])[:, None, None]
    off_x, off_y = x - boxes[:, 0, None, None], y - boxes[:, 1, None, None]
    half = boxes[:, 2:4, None, None] / 2
    inside = ((np.abs(c * off_x + s * off_y) < half[:, 0]) & (np.abs(c * off_y - s * off_x) < half[:, 1])).reshape(
        40, -1
    )
    common = inside.astype(np.float32) @ inside.T.astype(np.float32)
    areas = inside.sum(axis=1)
    truth = common / (areas[:, None] + areas - common)
    np.testing.assert_allclose(overlaps(boxes, boxes), truth, atol=0.02)


def _cars(*places: tuple[float, float]) -> Found:
    boxes = np.array([[x, y, 4.0, 2.0, 0.0] for x, y in places]).reshape(-1, 5)
    return Found(np.zeros(len(boxes), np.int64), np.linspace(0.9, 0.5, len(boxes)), boxes)


def _labels(*places: tuple[float, float], kind: str = "car"):
    count = len(places)
    middle = np.array([[x, y, -1.0] for x, y in places])
    return upright([kind] * count, range(count), middle, np.tile([4.0, 2.0, 1.5], (count, 1)), np.zeros(count))


def _measured(found: Found, kind: str = "car", fit: bool = True, frames: int = 20) -> Precision:
    labels, whole = _labels((10, 0), (20, 3), kind=kind), Precision()
    for frame in range(frames):
        whole.add(frame, found, labels, np.full(2, fit), sectors=1)
    return whole


@pytest.mark.parametrize(
    ("found", "expected"),
    [
        (_cars((10, 0), (20, 3)), 1.0),
        (_cars((10.5, 0.2), (20, 3)), 1.0),  # overlaps by more than half
        (_cars((10, 0)), 0.5),
        (_cars((30, 0), (10, 0), (20, 3)), 2 / 3),  # the surest one is nothing
        (_cars((10, 0), (10.2, 0), (20, 3)), 0.5 + 0.5 * 2 / 3),  # one car is found once
        (NONE, 0.0),
    ],
)
def test_average_precision_is_what_it_is_by_hand(found: Found, expected: float) -> None:
    assert precisions(_measured(found), _measured(found), 1)["vehicle"]["ap"] == pytest.approx(expected)


def test_lorries_and_cars_with_few_returns_are_neither_found_nor_missed() -> None:
    found = _cars((10, 0), (20, 3))
    assert precisions(_measured(found, "truck"), _measured(found, "truck"), 1) == {}
    cars, others = _measured(found), _measured(found, fit=False)
    cars.extend(others)
    assert precisions(cars, cars, 1)["vehicle"]["ap"] == 1.0


def test_what_decoding_costs_has_an_error_from_runs_of_frames() -> None:
    original = _measured(_cars((10, 0), (20, 3)), frames=40)
    worse = Precision()
    for frame in range(40):
        found = _cars((10, 0), (20, 3)) if frame < 20 else _cars((10, 0))
        worse.add(frame, found, _labels((10, 0), (20, 3)), np.full(2, True), sectors=1)
    score = precisions(worse, original, 1)["vehicle"]
    assert score["ap_difference"] == pytest.approx(-0.25, abs=0.01)
    assert 0.02 < score["ap_difference_error"] < 0.3
    assert score["objects"] == 80
    assert precisions(original, original, 1)["vehicle"]["ap_difference_error"] == 0


def _network() -> Network:
    rng = np.random.default_rng(2)
    return Network(
        {
            name: Layer(
                rng.normal(0, 0.05, (one.outputs, one.inputs, one.size, one.size)).astype(np.float32),
                np.zeros(one.outputs, np.float32),
            )
            for name, one in LAYERS.items()
        },
        {"trained_on": "nothing"},
    )


def test_weights_come_back_from_their_file_and_others_are_refused(tmp_path) -> None:
    network = _network()
    data = packed(network.layers, network.about, LAYERS)
    again = read_network(BytesIO(data))
    assert again.about == {"trained_on": "nothing"}
    for name, layer in network.layers.items():
        np.testing.assert_allclose(again.layers[name].weights, layer.weights, atol=0.002)
    for wrong in (b"", b"no zip", data[:-30]):
        with pytest.raises(SourceError, match="weights"):
            read_network(BytesIO(wrong), "x.npz")
    with pytest.raises(SourceError, match="cannot read the weights"):
        read_network(tmp_path / "missing.npz")


def test_the_weights_of_the_package_say_what_they_were_trained_on_and_may_be_used_by_companies() -> None:
    about = read_network(SHIPPED).about
    assert about["trained_on"] == "simulated drives"
    assert about["licence"] == "Apache-2.0"


def test_a_view_has_what_lies_in_front() -> None:
    points = np.array(
        [[12.0, 1.0, -1.0], [12.0, 1.05, -0.2], [-12.0, 1.0, -1.0], [12.0, 14.0, -1.0], [2e5, 0, 0], [5, 0, 9]]
    )
    view = seen(points, np.full(6, 255, np.uint8))
    assert view.shape == (CHANNELS, CELLS, CELLS)
    column = view[:, int(12 / 0.2), int((1 + DEPTH_M / 2) / 0.2)]
    assert column[-1] == 1
    assert view[:-2].sum() == 2
    assert view[-2].astype(bool).sum() == 1


def test_five_sectors_see_what_one_sees_and_what_lies_around() -> None:
    rng = np.random.default_rng(1)
    points = rng.uniform(-30, 30, (4000, 3)) * [1, 1, 0.05]
    network, intensity = _network(), np.zeros(4000, np.uint8)
    ahead, around = (found_in(network, points, intensity, sectors) for sectors in (1, 5))
    assert set(ahead.score.round(6)) & set(around.score.round(6))
    assert (around.boxes[:, 0] < -3).any() or not len(around.score)


@pytest.mark.sweep
def test_the_detector_finds_cars_of_a_simulated_town_and_fewer_of_them_in_a_poor_picture() -> None:
    from lidarcodec import StreamSettings

    drive = Detection("sim:city?seed=3", None, frames=3, detector=read_network(SHIPPED))
    original = drive.original()["detector"]["vehicle"]
    poor = drive.setting(StreamSettings(codec="predictive", max_error_m=1.5))["detector"]["vehicle"]
    assert original["objects"] >= 10
    assert original["ap"] > 0.4
    assert original["ap_difference"] == 0
    assert poor["ap"] < original["ap"] - 0.1

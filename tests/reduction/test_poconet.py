"""If these fail, a vehicle that sends what the network chose sends cars instead of walls, or nothing in time."""

from __future__ import annotations

import numpy as np
import pytest

from lidarcodec.api import read_frames
from lidarcodec.errors import SettingsError
from lidarcodec.frame import Frame
from lidarcodec.pipeline import check
from lidarcodec.reduction import make_reducer, table
from lidarcodec.reduction.score_image import CHANNELS, TURN_COLUMNS, score_image
from lidarcodec.settings import StreamSettings
from lidarcodec.sources.simulator import LABELS, SimulatorSource

NAMES = ("poconet", "poconet-paper")


@pytest.fixture(scope="module")
def road() -> tuple[Frame, np.ndarray]:
    """A frame of a road with cars around, which the network never saw, and what each cell is of."""
    with SimulatorSource("road", seed=77, frames=1) as source:
        (frame,) = read_frames(source)
        _, _, truth = source.truth(frame.side.packets)
    return frame, truth.T[frame.sensor.laser_of_ring]


def test_without_onnxruntime_they_are_not_offered_and_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(table, "find_spec", lambda name: None)
    table.reduction.cache_clear()
    try:
        assert not set(NAMES) & set(table.names())
        for name in NAMES:
            with pytest.raises(SettingsError, match=r"needs onnxruntime.*lidarcodec\[poconet\]"):
                check(StreamSettings(reduction=name))
    finally:
        table.reduction.cache_clear()


def test_the_image_holds_every_return_where_its_laser_looked(road: tuple[Frame, np.ndarray]) -> None:
    frame, _ = road
    image = score_image(frame)
    assert image.features.shape == (CHANNELS, 64, TURN_COLUMNS)
    assert image.features.dtype == np.float32
    seen = image.features[3] > 0
    assert seen.sum() > 0.9 * frame.valid.sum()  # the others share a pixel with a neighbour
    cloud, places = frame.cloud(), np.flatnonzero(frame.valid)
    row, column = np.divmod(image.pixel, TURN_COLUMNS)
    assert np.array_equal(row, places // frame.width)
    # the cloud is column by column, the places row by row
    direction = np.zeros(frame.range.shape[::-1])
    direction[frame.valid.T] = np.degrees(-np.arctan2(cloud["y"], cloud["x"])) % 360
    off = (column + 0.5) * 360 / TURN_COLUMNS - direction.T.ravel()[places]
    assert np.percentile(np.abs((off + 180) % 360 - 180), 99) < 1.0
    range_m = np.expm1(2 * (image.features[0].ravel()[image.pixel] + 1))
    assert np.median(np.abs(range_m - frame.range.ravel()[places] * 0.002)) < 0.01


def test_a_slab_is_seen_as_it_is_in_the_whole_turn(road: tuple[Frame, np.ndarray]) -> None:
    frame, _ = road
    some = slice(600, 774)
    slab = frame.with_(range=frame.range[:, some], intensity=frame.intensity[:, some], side=None,
                       azimuth=frame.azimuth[:, some], fired=frame.fired[:, some])  # fmt: skip
    image, whole = score_image(slab), score_image(frame)
    assert image.features.shape[2] < 400
    assert image.features.shape[2] % 16 == 0
    of_whole = np.zeros(frame.range.shape)
    of_whole.ravel()[np.flatnonzero(frame.valid)] = whole.features[0].ravel()[whole.pixel]
    mine = image.features[0].ravel()[image.pixel]
    assert np.mean(np.abs(mine - of_whole[:, some].ravel()[np.flatnonzero(slab.valid)]) < 0.05) > 0.9


def test_cars_around_are_left_out_and_little_else(road: tuple[Frame, np.ndarray]) -> None:
    pytest.importorskip("onnxruntime", reason="the extra `poconet`")
    frame, truth = road
    vehicle = (truth == LABELS.index("vehicle")) & frame.valid & (frame.range < 20_000)
    assert vehicle.sum() > 200, "without cars this shows nothing"
    settings = StreamSettings(reduction="poconet", keep_points=9000)
    reducer = make_reducer(settings)
    kept = reducer.reduce(frame).valid
    plain = make_reducer(settings.changed(reduction="voxel")).reduce(frame).valid
    assert kept.sum() == plain.sum() == 9000
    assert (kept & vehicle).sum() < 0.5 * (plain & vehicle).sum()
    assert 0 < reducer.report()["left_out"] < 0.1 * frame.points


def test_the_papers_rule_keeps_its_share_of_ground(road: tuple[Frame, np.ndarray]) -> None:
    pytest.importorskip("onnxruntime", reason="the extra `poconet`")
    frame, truth = road
    kept = make_reducer(StreamSettings(reduction="poconet-paper", keep_points=4000)).reduce(frame).valid
    assert kept.sum() == 4000
    on_ground = (truth[kept] == LABELS.index("ground")).mean()
    assert 0.1 < on_ground < 0.4


def test_what_ships_was_trained_on_simulated_drives_only_and_fits_into_a_megabyte() -> None:
    pytest.importorskip("onnxruntime", reason="the extra `poconet`")
    from importlib.resources import files

    from lidarcodec.reduction.score_network import OF_HDL64E, OF_OTHERS, about

    for weights in (OF_HDL64E, OF_OTHERS):
        told = about(weights)
        assert told["trained_on"].startswith("simulated drives")
        assert "KITTI" not in told["trained_on"]
        assert told["licence"]
        assert len(files("lidarcodec.reduction").joinpath(weights).read_bytes()) < 1_000_000
    others = about(OF_OTHERS)
    assert {"vlp16", "os1-128"} < set(others["sensors"].split(", "))
    assert int(others["steps"]) > 100
    assert int(others["seconds"]) > 0

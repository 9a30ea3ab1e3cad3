"""If these fail, a team with a Puck or an Ouster sends what a network chose for another sensor, or nothing in time."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from lidarcodec.api import read_frames
from lidarcodec.frame import Frame
from lidarcodec.pipeline import frames_of
from lidarcodec.reduction import make_reducer
from lidarcodec.reduction.score_image import CHANNELS, score_image
from lidarcodec.reduction.spread import LENGTHS_PER_M, returns_of
from lidarcodec.settings import StreamSettings
from lidarcodec.sources import open_source
from lidarcodec.sources.simulator import LABELS
from lidarcodec.sources.spinning.source import SpinningSource
from lidarcodec.sources.spinning.table import Wanted
from tests.sweeps import sampled

SENSORS = sampled(["vlp16", "vlp32c", "xt32", "pandar40p", "os1-128"], ["vlp16", "os1-128"])


@cache
def road(sensor: str) -> tuple[Frame, np.ndarray]:
    """A frame of a road with cars around, which the network never saw, and what each cell is of."""
    with SpinningSource(Wanted(sensor), "road", seed=77, frames=1) as source:
        frame = next(iter(read_frames(source)))
        return frame, source.truth(frame.side.packets).labels


@pytest.mark.parametrize("sensor", SENSORS)
def test_the_image_holds_every_return_where_its_beam_looked(sensor: str) -> None:
    frame, _ = road(sensor)
    image, returns = score_image(frame), returns_of(frame)
    channels, rows, columns = image.features.shape
    assert (channels, rows, columns % 16) == (CHANNELS, -(-frame.sensor.rows // 8) * 8, 0)
    row, column = np.divmod(image.pixel, columns)
    assert np.array_equal(row, returns.cells // frame.width)
    seen = image.features[3] > 0
    assert seen.sum() > 0.95 * len(returns.cells), "the others share a pixel with a neighbour"
    x, y, z = returns.xyz.T / LENGTHS_PER_M
    off = (column + 0.5) * 360 / columns - np.degrees(-np.arctan2(y, x)) % 360
    assert np.percentile(np.abs((off + 180) % 360 - 180), 98) < 360 / columns
    range_m = np.expm1(2 * (image.features[0].ravel()[image.pixel] + 1))
    metres = frame.range.ravel()[returns.cells] * frame.sensor.range_step_m
    assert np.median(np.abs(range_m - metres)) < 0.01
    assert np.median(np.abs(image.features[1].ravel()[image.pixel] - (z + 1) / 4)) < 0.01


def test_a_part_of_a_turn_is_seen_as_it_is_in_the_whole_turn() -> None:
    with open_source("sim:road?seed=77&sensor=vlp16&frames=1") as source:
        packets = list(source.packets())
        (whole,) = frames_of(packets, source.sensor)
        part = next(iter(frames_of(packets, source.sensor, "packets:20")))
    image, of_whole = score_image(part), score_image(whole)
    assert image.features.shape[2] < of_whole.features.shape[2] / 2
    values = np.full(whole.range.shape, np.nan)
    values.ravel()[returns_of(whole).cells] = of_whole.features[0].ravel()[of_whole.pixel]
    same = values[:, : part.width].ravel()[returns_of(part).cells]
    assert np.mean(np.abs(image.features[0].ravel()[image.pixel] - same) < 0.05) > 0.9


def test_a_frame_without_returns_or_of_other_packets_is_kept_as_it_is() -> None:
    pytest.importorskip("onnxruntime", reason="the extra `poconet`")
    frame, _ = road("vlp16")
    empty = frame.with_(range=np.zeros_like(frame.range))
    assert score_image(empty).pixel.shape == (0,)
    for name in ("poconet", "poconet-paper"):
        assert make_reducer(StreamSettings(reduction=name, keep_points=100)).reduce(empty) is empty


@pytest.mark.parametrize("sensor", SENSORS)
def test_cars_around_are_left_out_and_little_else(sensor: str) -> None:
    pytest.importorskip("onnxruntime", reason="the extra `poconet`")
    frame, truth = road(sensor)
    metres = frame.range * frame.sensor.range_step_m
    vehicle = (truth == LABELS.index("vehicle")) & frame.valid & (metres > 3) & (metres < 40)
    assert vehicle.sum() > 50, "without cars this shows nothing"
    settings = StreamSettings(reduction="poconet", keep_fraction=0.1)
    reducer, again = make_reducer(settings), make_reducer(settings)
    kept = reducer.reduce(frame).valid
    plain = make_reducer(settings.changed(reduction="voxel")).reduce(frame).valid
    assert kept.sum() == plain.sum() == int(0.1 * frame.points + 0.5)
    assert np.array_equal(kept, again.reduce(frame).valid)
    assert (kept & vehicle).sum() < 0.5 * (plain & vehicle).sum()

"""What a user loses if these fail: figures of objects that hang on returns which nobody measured, or on no real
ground."""

import numpy as np
import pytest

from lidarcodec import _native
from lidarcodec.errors import LidarCodecError, SourceError
from lidarcodec.evaluation.detection.boxes import upright
from lidarcodec.evaluation.detection.objects import objects_in
from lidarcodec.evaluation.detection.segments import Segments, ground_overlap, segments_of, surfaces_of
from lidarcodec.filling import filled
from lidarcodec.image_frame import cloud_frame
from lidarcodec.pipeline import StreamDecoder, StreamEncoder, frames_of
from lidarcodec.sensors.clouds.sensor import cloud_sensor
from lidarcodec.settings import StreamSettings
from lidarcodec.sources import open_source
from lidarcodec.sources.drive import LABELS
from lidarcodec.wire import pack, unpack
from tests import point_clouds

HEIGHT_M = 1.7
CARS = ((12.0, 0.0), (12.0, 6.0))
"""Middle of each upright cylinder with a radius of 1 m."""


def scene():
    """Points (N, 3), rows (N,) and truth (N,) of 40 beams over flat ground with two cylinders: -1 = ground."""
    elevation = np.radians(np.linspace(2, -24, 40))[:, None]
    azimuth = np.radians(np.arange(0, 360, 0.4) - 180)[None]
    far = np.where(elevation < 0, HEIGHT_M / np.tan(np.maximum(-elevation, 1e-6)), 1e9) + 0 * azimuth
    truth = np.full(far.shape, -1)
    for number, (x, y) in enumerate(CARS):
        along = x * np.cos(azimuth) + y * np.sin(azimuth)
        beside = x * x + y * y - along**2
        hit = along - np.sqrt(np.maximum(1 - beside, 0))
        met = (beside < 1) & (along > 0) & (hit < far) & (hit * np.tan(elevation) < 0.2)
        far, truth = np.where(met, hit, far), np.where(met, number, truth)
    seen = far < 60
    points = np.stack((far * np.cos(azimuth), far * np.sin(azimuth), far * np.tan(elevation)), axis=-1)[seen]
    rows = np.broadcast_to(np.arange(40)[:, None], far.shape)[seen]
    return np.ascontiguousarray(points, np.float32), rows.astype(np.uint16), truth[seen]


def test_ground_and_two_objects_are_told_apart():
    points, rows, truth = scene()
    ground = _native.ground_points(points)
    low = points[:, 2] > -HEIGHT_M + 0.25  # an object that stands on the ground has a lowest part that may be either
    assert np.all(ground[truth < 0] == 1)
    assert not np.any(ground[(truth >= 0) & low])
    clusters = _native.cluster_points(points, rows, ground)
    names = [np.unique(clusters[(truth == number) & low]) for number in (0, 1)]
    assert sorted(map(len, names)) == [1, 1]
    assert names[0] != names[1]
    boxes = upright(["car"] * 2, [1, 2], np.array([(*car, -0.75) for car in CARS]), np.full((2, 3), 2.0), np.zeros(2))
    found = objects_in(boxes, Segments(points, np.arange(len(points)), ground.view(np.bool_), clusters))
    assert np.all(found.overlap > 0.95)
    assert np.all(found.size[:, 1] > 1.6)


def test_a_cloud_in_another_order_has_the_same_objects():
    points, rows, _ = scene()
    order = np.random.default_rng(1).permutation(len(points))
    ground = _native.ground_points(points)
    again = _native.ground_points(points[order])
    assert np.array_equal(ground[order], again)
    one, other = (
        _native.cluster_points(points, rows, ground)[order],
        _native.cluster_points(points[order], rows[order], again),
    )
    pairs = np.unique(np.stack((one, other)), axis=1)
    assert len(pairs.T) == len(np.unique(one)) == len(np.unique(other))


@pytest.mark.parametrize("number", [0, 1, 2])
def test_few_points_are_no_problem(number):
    points, rows = np.full((number, 3), 5.0, np.float32), np.zeros(number, np.uint16)
    ground = _native.ground_points(points)
    assert len(_native.cluster_points(points, rows, ground)) == len(ground) == number


def test_what_is_no_cloud_is_refused():
    points, rows, ground = np.zeros((3, 3), np.float32), np.zeros(3, np.uint16), np.zeros(3, np.uint8)
    bad = points.copy()
    bad[1, 2] = np.nan
    for call in (
        lambda: _native.ground_points(bad),
        lambda: _native.ground_points(np.zeros((3, 2), np.float32)),
        lambda: _native.cluster_points(bad, rows, ground),
        lambda: _native.cluster_points(points, rows[:2], ground),
        lambda: _native.cluster_points(points, rows, ground[:2]),
        lambda: _native.cluster_points(points, rows + np.uint16(4096), ground),
    ):
        with pytest.raises(LidarCodecError):
            call()


def test_huge_and_tiny_coordinates_have_an_answer():
    values = np.array([0, -0.0, 1e-38, 1e30, -1e30, 3e38, 1.0], np.float32)
    points = np.stack(np.meshgrid(values, values, values), axis=-1).reshape(-1, 3)
    points = np.ascontiguousarray(points)
    ground = _native.ground_points(points)
    assert len(_native.cluster_points(points, np.zeros(len(points), np.uint16), ground)) == len(points)


@pytest.fixture(scope="module")
def drive():
    source = open_source("sim:street?seed=2&frames=1")
    return source, next(iter(frames_of(source.packets(), source.sensor, "revolution")))


def test_the_ground_of_a_simulated_street_is_its_ground(drive):
    source, frame = drive
    _, _, labels = source.truth(frame.side.packets)
    truth = labels.reshape(-1, 64)[:, frame.sensor.laser_of_ring][frame.valid.T] == LABELS.index("ground")
    parts = segments_of(frame)
    near = np.linalg.norm(parts.points[:, :2], axis=1) > 3
    assert np.count_nonzero(truth & parts.ground & near) / np.count_nonzero((truth | parts.ground) & near) > 0.9


def test_interpolated_returns_are_never_measured_ones(drive):
    encoder, decoder = StreamEncoder(StreamSettings(codec="predictive", target_kbps=500)), StreamDecoder()
    (sent,) = [frame for message in encoder.encode(drive[1]) for frame in decoder.decode(unpack(pack(message)))]
    shown = filled(sent)
    assert shown.points > 3 * sent.points
    bare, parts = segments_of(sent), segments_of(shown)
    assert np.array_equal(parts.cells, bare.cells)
    assert np.array_equal(parts.clusters, bare.clusters)
    both, either = ground_overlap(surfaces_of(segments_of(drive[1])), parts)
    assert 0.8 * either < both <= either <= len(parts.points)


def test_a_point_cloud_is_refused():
    payload = point_clouds.message(point_clouds.velodyne())
    frame = cloud_frame(0, 0, payload, cloud_sensor([payload]))
    with pytest.raises(SourceError, match="point cloud"):
        segments_of(frame)

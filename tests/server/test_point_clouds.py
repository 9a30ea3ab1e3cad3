"""What a user loses if these fail: the clouds of ROS messages in the page, where they are and as images."""

from __future__ import annotations

import asyncio
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from lidarcodec.frame import Frame
from lidarcodec.image_frame import cloud_frame
from lidarcodec.packet import Packet
from lidarcodec.pipeline import frames_of
from lidarcodec.sensors.clouds.sensor import cloud_sensor
from lidarcodec_server.live.cloud_format import HEADER, THINNED, Encoding, Facts, packed, sensor_facts
from lidarcodec_server.live.options import CloudOptions
from lidarcodec_server.live.view import FrameView
from lidarcodec_server.live.viewer import CloudViewer
from tests.point_clouds import STAMP_NS, message, ouster, velodyne
from tests.sensors.made_frames import block_sensor, made_frames
from tests.server.live import client_module

PAYLOAD = message(velodyne(200))
FRAME = cloud_frame(3, STAMP_NS, PAYLOAD, cloud_sensor([PAYLOAD]))
CLIENT = client_module()
FACTS = Facts(7, 1, 0, None, STAMP_NS)


def test_points_are_where_the_message_says():
    data = packed(FRAME, FACTS, Encoding("points", ("intensity", "ring"), None))
    count = FRAME.points
    x = np.frombuffer(data, "<i2", count, HEADER.size)
    sent = velodyne(200)["x"]
    assert np.corrcoef(x, sent)[0, 1] > 0.9999999


def bare(points: npt.NDArray[np.void], order: npt.NDArray[np.intp] | None = None) -> npt.NDArray[np.void]:
    """The same points without a ring, in another order."""
    found = np.zeros(len(points), [(name, "<f4") for name in ("x", "y", "z", "intensity")])
    for name in found.dtype.names or ():
        found[name] = points[name]
    return found if order is None else found[order]


def at(points: npt.NDArray[np.void], place: tuple[float, float, float]) -> npt.NDArray[np.void]:
    """The same with one more point at a place."""
    found = np.append(points, points[-1:])
    for name, value in zip("xyz", place, strict=True):
        found[name][-1] = value
    return found


def far(points: npt.NDArray[np.void], times: float) -> npt.NDArray[np.void]:
    found = points.copy()
    for name in "xyz":
        found[name] *= times
    return found


def blob() -> npt.NDArray[np.void]:
    found = bare(np.resize(velodyne(8), 6_000))
    for name in "xyz":
        found[name] = np.random.default_rng(ord(name)).normal(0, 15, len(found))
    return found


TURN = velodyne(200)
ANY = np.random.default_rng(1).permutation(len(TURN))
CLOUDS = {
    "rings": message(TURN),
    "four rings": message(TURN[TURN["ring"] < 4]),
    "no rings, column by column": message(bare(TURN)),
    "in any order": message(bare(TURN, ANY)),
    "in any order, one far up": message(at(bare(TURN, ANY), (0.2, 0.1, 30.0))),
    "far away": message(far(TURN, 20)),
    "farther than an image reaches": message(at(TURN, (4e5, 0.0, 0.0))),
    "a blob": message(blob()),
    "a sector": message(TURN[np.abs(np.arctan2(TURN["y"], TURN["x"])) < 1.0]),
    "organised": message(ouster(128, 16), 16),
    "128 rows": message(velodyne(50, 128)),
    "none": message(TURN[:0]),
}


def frame_of(payload: bytes, first: bytes = PAYLOAD, index: int = 3) -> Frame:
    """The frame of a message in a stream that began with another one."""
    return cloud_frame(index, STAMP_NS, payload, cloud_sensor([first]))


def nearest(points: npt.NDArray[Any], others: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """(N,) distance from each of some points to the nearest of others."""
    some = points[:: max(1, len(points) // 80)]
    return np.array([np.sqrt(((others - one) ** 2).sum(axis=1).min()) for one in some])


def drawn(data: bytes, facts: dict[str, Any]) -> npt.NDArray[Any]:
    """(N, 3) points of a message of form range, as docs/live-sockets.md says."""
    head, arrays = CLIENT.read_message(data)
    assert head["rings"] == facts["rings"]
    found: npt.NDArray[Any] = CLIENT.points_of_range(head, arrays, facts)
    return found


@pytest.mark.parametrize("first", ["none", "four rings", "128 rows"])
@pytest.mark.parametrize("name", CLOUDS)
def test_a_viewer_of_range_images_draws_points_where_they_are_whatever_came_first(name, first):
    frame = frame_of(CLOUDS[name], CLOUDS[first])
    data = packed(frame, FACTS, Encoding("range", ("intensity",), None))
    points = drawn(data, sensor_facts(frame.sensor, frame))
    cloud = frame.cloud()
    there = np.stack([cloud[axis] for axis in "xyz"], axis=1).astype(np.float64)
    there = there[np.sqrt((there**2).sum(axis=1)) < 1000]
    if not len(there):
        return
    away = np.sqrt((points**2).sum(axis=1))[:: max(1, len(points) // 80)]
    assert (nearest(points, there) <= 0.15 + 0.02 * away).all()
    assert len(points) >= 0.85 * len(there)
    assert np.percentile(nearest(there, points), 90) < 0.6


def told_of(viewer: CloudViewer, frame: Frame) -> list[dict[str, Any]]:
    """Events that a viewer gets before a frame."""
    viewer.show(FrameView(frame, FACTS))

    async def given() -> Any:
        work = asyncio.get_running_loop().run_in_executor
        return await viewer._next([], lambda make: work(None, make))

    found: list[dict[str, Any]] = asyncio.run(given()).events
    return found


def test_a_viewer_is_told_of_rows_when_they_change_and_not_again():
    viewer = CloudViewer(CloudOptions.of({"form": "range"}))

    def told(payload: bytes, index: int) -> list[dict[str, Any]]:
        return told_of(viewer, frame_of(payload, CLOUDS["none"], index))

    assert [one["rings"] for one in told(CLOUDS["none"], 0)] == [64]
    (event,) = told(CLOUDS["rings"], 1)
    assert np.ptp(event["vert_correction_rad"][:16]) > 0.5
    assert told(message(velodyne(200, seed=2)), 2) == []  # the same sensor, elsewhere
    assert len(told(CLOUDS["far away"], 3)) == 1  # larger steps


def test_rows_are_told_once_a_frame_has_some():
    sensor = block_sensor("vlp16")
    (frame,) = made_frames(sensor, "single", 4, 1)
    (odd,) = frames_of([Packet(bytes(range(256)) * 5, STAMP_NS)], sensor, "packets:1")
    viewer, told = CloudViewer(CloudOptions.of({"form": "range"})), []
    for one in (odd, frame, frame):
        told.append(told_of(viewer, one))
    assert [len(events) for events in told] == [1, 1, 0]
    assert np.ptp(told[1][0]["vert_correction_rad"]) > 0.5


def test_one_point_far_away_does_not_blur_the_others():
    frame = frame_of(CLOUDS["farther than an image reaches"])
    data = packed(frame, FACTS, Encoding("points", (), None))
    head, _ = CLIENT.read_message(data)
    assert head["scale_m"] < 0.005
    assert head["count"] == len(TURN)
    assert head["returns"] == len(TURN) + 1
    assert head["flags"] & THINNED


def test_facts_have_a_value_for_each_ring():
    facts = sensor_facts(FRAME.sensor, FRAME)
    assert facts["model"] == "pointcloud2"
    assert facts["rings"] == 16 == len(facts["vert_correction_rad"])

"""What a user loses if these fail: the clouds of ROS messages in the page, where they are and as images."""

from __future__ import annotations

import numpy as np

from lidarcodec.image_frame import cloud_frame
from lidarcodec.sensors.clouds.sensor import cloud_sensor
from lidarcodec_server.live.cloud_format import HEADER, Encoding, Facts, packed, sensor_facts
from lidarcodec_server.live.ring_geometry import CLOUD_STEP, ring_geometry, shown_ranges
from tests.point_clouds import STAMP_NS, message, velodyne

PAYLOAD = message(velodyne(200))
FRAME = cloud_frame(3, STAMP_NS, PAYLOAD, cloud_sensor([PAYLOAD]))
FACTS = Facts(7, 1, 0, None, STAMP_NS)


def test_points_are_where_the_message_says():
    data = packed(FRAME, FACTS, Encoding("points", ("intensity", "ring"), None))
    count = FRAME.points
    x = np.frombuffer(data, "<i2", count, HEADER.size)
    sent = velodyne(200)["x"]
    assert np.corrcoef(x, sent)[0, 1] > 0.9999999


def test_a_range_image_and_the_geometry_of_its_rings_give_the_points():
    geometry = ring_geometry(FRAME)
    assert geometry is not None
    assert np.allclose(np.degrees(geometry.vert_correction_rad), np.linspace(15, -15, 16), atol=0.01)
    ranges = shown_ranges(FRAME)
    assert np.count_nonzero(ranges) == FRAME.points
    metres = ranges * (CLOUD_STEP * FRAME.sensor.range_step_m)
    column, ring = np.nonzero(ranges.T)
    beta = np.radians(FRAME.azimuth[0, column] * 0.01) - geometry.rot_correction_rad[ring]
    flat = metres[ring, column] * np.cos(geometry.vert_correction_rad[ring])
    came = np.stack([flat * np.cos(beta), -flat * np.sin(beta)], axis=1)
    cloud = FRAME.cloud()
    assert np.abs(np.sort(came[:, 0]) - np.sort(cloud["x"])).max() < 0.1
    assert np.abs(np.sort(came[:, 1]) - np.sort(cloud["y"])).max() < 0.1


def test_facts_have_a_value_for_each_ring():
    facts = sensor_facts(FRAME.sensor, FRAME)
    assert facts["model"] == "pointcloud2"
    assert facts["rings"] == 16 == len(facts["vert_correction_rad"])

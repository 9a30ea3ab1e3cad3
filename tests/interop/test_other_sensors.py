"""If these fail, Foxglove and ROS 2 show wrong rings or cut intensities of another sensor than an HDL-64E."""

from __future__ import annotations

import numpy as np
import pytest

from lidarcodec.interop import foxglove, point_cloud2
from lidarcodec.pipeline import frames_of
from lidarcodec.sources import open_source

FILES = {
    "sensors/velodyne/vlp16.pcap.xz": 1,
    "sensors/hesai/pandar_40p.pcap.xz": 1,
    "sensors/ouster/OS-1-32-G_v2.1.1_1024x10.pcap.xz": 2,
}
"""Capture -> bytes of an intensity."""


@pytest.mark.data
@pytest.mark.parametrize("marks", [False, True])
@pytest.mark.parametrize("name", FILES)
def test_points_have_the_rings_and_intensities_of_the_sensor(data_file, name, marks):
    with open_source(data_file(name)) as source:
        frame = next(frames_of(source.packets(), source.sensor))
    cloud = frame.cloud()
    assert cloud["intensity"].dtype.itemsize == FILES[name]
    points = foxglove.points_of(frame, marks=marks)
    for field in ("x", "y", "z", "intensity", "ring"):
        assert np.array_equal(points[field], cloud[field]), field
    assert points.dtype.itemsize == 17 + FILES[name] + marks
    assert points.tobytes() in foxglove.point_cloud(frame, "lidar", marks=marks)
    points = point_cloud2.points_of(frame, marks=marks)
    assert np.array_equal(points["ring"], frame.sensor.rows - 1 - cloud["ring"].astype(np.int64))
    assert np.array_equal(points["intensity"], cloud["intensity"])
    assert points.tobytes() in point_cloud2.point_cloud2(frame, "lidar", marks=marks)

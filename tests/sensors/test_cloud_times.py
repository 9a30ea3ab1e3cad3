"""Absolute times of the points of a message, as drivers give them: in seconds or ns, of the host's clock or another."""

import numpy as np
import pytest

from lidarcodec.sensors.clouds.message import read_message
from lidarcodec.sensors.clouds.values import times_ns
from tests.planes.cloud_messages import absolute_times
from tests.point_clouds import STAMP_NS, velodyne

BEGIN_S = 1_700_000_000.0
AFTER_NS = velodyne(100)["time"].astype(np.float64) * 1e9
FIRST_NS = int(BEGIN_S) * 10**9 - STAMP_NS


@pytest.mark.parametrize("unit", [1.0, 1e9], ids=["s", "ns"])
def test_times_since_the_epoch_are_those_of_the_points(unit):
    """Hesai and Robosense give seconds, Livox gives ns."""
    found = times_ns(read_message(absolute_times(BEGIN_S, unit)))
    assert np.abs(found - FIRST_NS - AFTER_NS).max() < 1000


@pytest.mark.parametrize("unit", [1.0, 1e9], ids=["s", "ns"])
def test_times_of_a_clock_that_nobody_set_count_from_the_first_point(unit):
    found = times_ns(read_message(absolute_times(1234.5, unit)))
    assert found.min() == 0
    assert np.abs(found - (AFTER_NS - AFTER_NS.min())).max() < 1000


def test_points_without_a_time_have_that_of_their_message():
    found = times_ns(read_message(absolute_times(gaps=True)))
    assert found[3:6].tolist() == [0, 0, 0]
    others = np.delete(np.arange(len(found)), [3, 4, 5])
    assert np.abs(found - FIRST_NS - AFTER_NS)[others].max() < 1000

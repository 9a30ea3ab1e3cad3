"""If these fail, a replayed drive is published with poses of other moments, and its points lie beside each other."""

from __future__ import annotations

import itertools
import threading

import numpy as np

from lidarcodec.apps.clocks import Clock
from lidarcodec.apps.publisher.source import FrameFeed
from tests.apps.streams import START_NS, Loop

TURN_NS = 348 * 288_000


class Along:
    """Poses of a car that goes a metre a turn, and the times for which they were asked."""

    def __init__(self) -> None:
        self.asked: list[int] = []

    def at(self, stamp_ns: int) -> np.ndarray:
        self.asked.append(stamp_ns)
        pose = np.eye(4)
        pose[0, 3] = (stamp_ns - START_NS) / TURN_NS
        return pose


def test_a_replay_that_is_held_up_in_mid_frame_has_the_poses_of_its_first_packets():
    """As on a machine that others use too: 0.2 s in the first frame, 0.3 s between the second and the third."""
    held_up = {300: 200_000_000, 2 * 348: 300_000_000}
    steps = (288_000 + held_up.get(number, 0) for number in itertools.count())
    clock = Clock(wall_ns=itertools.accumulate(steps, initial=10**18).__next__)
    poses, frames = Along(), []
    feed = FrameFeed(Loop(3), "packets", 1e6, poses=poses, clock=clock)
    thread = threading.Thread(target=feed.run, kwargs={"wait": True})
    thread.start()
    while len(frames) < 3:
        frames.append(feed.mailbox.take(60.0))
    thread.join()
    assert poses.asked == [START_NS + number * TURN_NS for number in range(3)]
    assert [frame.pose[0, 3] for frame in frames] == [0.0, 1.0, 2.0]

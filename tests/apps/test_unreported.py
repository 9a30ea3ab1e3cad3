"""No frame is lost in silence: what a publisher sends arrives, or the publisher says that it did not."""

from __future__ import annotations

import time

import pytest

from lidarcodec.apps.publish import Publisher
from lidarcodec.apps.reports import Arrival, pack_arrival
from lidarcodec.settings import StreamSettings
from lidarcodec.transport.base import Priority
from lidarcodec.transport.keys import StreamKeys
from lidarcodec.transport.memory import MemoryNetwork
from lidarcodec.wire import unpack
from tests.apps.streams import Loop
from tests.transport.test_contract import eventually

KEYS = StreamKeys()
GROUPS = StreamSettings(codec="jpeg-layered", codec_settings={"group": 8}, intensity="off")


class Slow:
    """A receiver that takes a while to look into its ring."""

    def __init__(self, end) -> None:
        self._inbox, self._arrivals = end.inbox(KEYS.frame), end.sender(KEYS.arrived("slow"), Priority.REAL_TIME)
        self._token = end.token(KEYS.arrived("slow"))
        self.frames: list[int] = []

    def take(self, wait_s: float) -> int:
        """Wait, then take the newest message and report it; its codec."""
        time.sleep(wait_s)
        message = unpack(self._inbox.receive())
        self.frames += range(message.frame_index, message.frame_index + message.frame_count)
        self._arrivals.put(pack_arrival(Arrival(message.frame_index, time.time_ns(), 0)))
        return message.codec


@pytest.fixture
def ends():
    """The network's two ends."""
    network = MemoryNetwork()
    with network.transport() as car, network.transport() as office:
        yield car, office


def test_a_group_that_a_change_of_codec_ends_is_not_overtaken_by_the_next_frame(ends):
    """Both become complete at once; a receiver has room for one."""
    car, office = ends
    slow = Slow(office)
    with Publisher(Loop(), GROUPS, transport=car, rate=40.0) as publisher:
        codec = slow.take(0.0)
        slow.take(0.0)  # the first groups are cut short by requests for key frames
        slow.take(0.0)
        assert eventually(lambda: publisher.next_index >= slow.frames[-1] + 4, 20)
        changed = publisher.change(codec="pcodec")
        while slow.take(0.2) == codec:
            pass
        assert publisher.status()["flight"]["unreported"] == 0
    assert slow.frames[-1] >= changed.first_frame
    assert changed.first_frame - 1 in slow.frames, "it was in the group"


def test_the_last_group_of_a_source_does_not_overtake_the_one_before(ends):
    car, office = ends
    slow = Slow(office)
    with Publisher(Loop(20), GROUPS, transport=car, rate="max"):
        while not slow.frames or slow.frames[-1] < 19:
            slow.take(0.3)
    assert slow.frames == list(range(20))


def test_frames_that_never_arrived_are_told(ends):
    """A receiver that stands still for so long that messages are given up misses all but the newest."""
    car, office = ends
    slow = Slow(office)
    with Publisher(Loop(), StreamSettings(codec="raw"), transport=car, rate=40.0) as publisher:
        for _ in range(12):
            slow.take(0.0)
        assert eventually(lambda: publisher.status()["flight"]["timeouts"] >= 2, 20)
        slow.take(0.0)
        assert eventually(lambda: publisher.status()["flight"]["unreported"] >= 1, 20)
        status = publisher.status()
    missing = set(range(slow.frames[-1])) - set(slow.frames)
    assert len(missing) <= status["replaced"] + status["flight"]["unreported"]

"""No frame is lost in silence: what a publisher sends arrives, or the publisher says that it did not."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from lidarcodec.apps.publisher.publisher import Publisher
from lidarcodec.apps.reports import Arrival, pack_arrival
from lidarcodec.message import Message
from lidarcodec.packet import Packet
from lidarcodec.settings import StreamSettings
from lidarcodec.transport.base import Priority
from lidarcodec.transport.keys import StreamKeys
from lidarcodec.transport.memory import MemoryNetwork
from lidarcodec.wire import checksum_of, unpack
from tests.apps.streams import Loop
from tests.calm import when_calm
from tests.transport.test_contract import eventually

KEYS = StreamKeys()
GROUPS = StreamSettings(codec="jpeg-layered", codec_settings={"group": 8}, intensity="off", framing="packets")


class Slow:
    """A receiver that takes a while to look into its ring."""

    def __init__(self, end) -> None:
        self._inbox, self._arrivals = end.inbox(KEYS.frame), end.sender(KEYS.arrived("slow"), Priority.REAL_TIME)
        self._token = end.token(KEYS.arrived("slow"))
        self.frames: list[int] = []

    def lose(self) -> Message:
        """Take the newest message, and never report it: it might as well have been lost."""
        return unpack(self._inbox.receive())

    def take(self) -> Message | None:
        """Take the newest message and report it. None once closed."""
        data = self._inbox.receive()
        if data is None:
            return None
        message = unpack(data)
        self.frames += range(message.frame_index, message.frame_index + message.frame_count)
        self._arrivals.put(pack_arrival(Arrival(message.frame_index, time.time_ns(), 0, checksum_of(data))))
        return message

    @contextmanager
    def taking(self, wait_s: float) -> Iterator[None]:
        """Take what comes, but wait so long before each."""

        def run() -> None:
            time.sleep(wait_s)
            while self.take() is not None:
                time.sleep(wait_s)

        thread = threading.Thread(target=run)
        thread.start()
        try:
            yield
        finally:
            self._inbox.close()
            thread.join()


class Halting(Loop):
    """A source that stops for a while behind some frames."""

    def __init__(self, frames: int) -> None:
        super().__init__()
        self._before, self.go_on = frames, threading.Event()

    def packets(self) -> Iterator[Packet]:
        for number, packet in enumerate(super().packets()):
            if number == 348 * self._before:
                self.go_on.wait()
            yield packet


@contextmanager
def networked():
    """The network's two ends."""
    network = MemoryNetwork()
    with network.transport() as car, network.transport() as office:
        yield car, office


@pytest.fixture
def ends():
    with networked() as both:
        yield both


def test_a_group_that_a_change_of_codec_ends_is_not_overtaken_by_the_next_frame(ends):
    """Both become complete at once; a receiver has room for one."""
    car, office = ends
    slow, source = Slow(office), Halting(12)
    with Publisher(source, GROUPS, transport=car, rate="max") as publisher, slow.taking(0.2):
        assert eventually(lambda: publisher.next_index == 12, 60)
        publisher.change(codec="pcodec")
        source.go_on.set()
        assert eventually(lambda: slow.frames[-1] >= 16, 60)
    assert slow.frames == list(range(slow.frames[-1] + 1))


def test_the_last_group_of_a_source_does_not_overtake_the_one_before(ends):
    car, office = ends
    slow = Slow(office)
    with Publisher(Loop(20), GROUPS, transport=car, rate="max") as publisher, slow.taking(0.3):
        assert publisher.wait(60)
    assert slow.frames == list(range(20))


def test_frames_that_never_arrived_are_told(ends):
    """A receiver that stands still for so long that messages are given up misses all but the newest."""
    car, office = ends
    slow = Slow(office)
    with Publisher(Loop(), StreamSettings(codec="raw"), transport=car, rate=40.0) as publisher:
        for _ in range(12):
            slow.take()
        assert eventually(lambda: publisher.status()["flight"]["timeouts"] >= 2)
        slow.take()
        assert eventually(lambda: publisher.status()["flight"]["unreported"] >= 1)
        status = publisher.status()
    missing = set(range(slow.frames[-1])) - set(slow.frames)
    assert len(missing) <= status["replaced"] + status["flight"]["unreported"]


@pytest.mark.parametrize("refers", [True, False])
def test_what_follows_a_lost_key_message_is_another(ends, refers):
    car, office = ends
    slow = Slow(office)
    with Publisher(Loop(), histories(refers=refers), transport=car, rate=40.0) as publisher:
        slow.lose()
        assert slow.take().key
        assert eventually(lambda: publisher.status()["flight"]["unreported"] == 1)


def test_what_follows_a_lost_message_refers_to_one_that_arrived():
    """Else its receiver could not decode it, would ask for a key frame, and would miss two frames for one.

    A report that a busy machine delays counts as lost, too, and a key frame follows.
    """

    def refers():
        with networked() as (car, office):
            slow = Slow(office)
            with Publisher(Loop(), histories(refers=True), transport=car, rate=40.0) as publisher:
                while slow.take().key:
                    pass
                arrived = slow.frames[-1]
                assert slow.lose().needs == arrived
                assert slow.take().needs == arrived
                assert slow.take().needs == slow.frames[-2]
                assert eventually(lambda: publisher.status()["flight"]["unreported"] == 1)

    when_calm(refers, 0.005)


def histories(*, refers: bool) -> StreamSettings:
    return StreamSettings(codec_settings={"mask_history": refers}, intensity="off", key_interval=10_000)

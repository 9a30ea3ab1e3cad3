"""A key frame that was asked for comes, whatever else goes on: a recording that waits for one must not stay empty."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from lidarcodec.apps.publisher.publisher import Publisher
from lidarcodec.apps.receiver.receiver import Receiver
from lidarcodec.settings import StreamSettings
from lidarcodec.transport.keys import StreamKeys
from lidarcodec.transport.memory import MemoryNetwork
from lidarcodec.wire import unpack
from tests.apps.streams import Loop
from tests.transport.test_contract import eventually

SETTINGS = StreamSettings(codec="zstd", key_interval=100_000)


class Watching:
    """Receives, and knows which messages were key messages; `at_key` is called at each, in the receive thread."""

    def __init__(self, end) -> None:
        self.keys: list[int] = []
        self.frames: list[int] = []
        self.at_key: Callable[[], object] = lambda: None
        self.receiver = Receiver(
            StreamKeys(),
            "viewer",
            lambda frame: self.frames.append(frame.index),
            self._came,
            lambda: None,
            transport=end,
        )

    def _came(self, data: bytes) -> None:
        message = unpack(data)
        if message.key:
            self.keys.append(message.frame_index)
            self.at_key()


@pytest.fixture
def ends():
    """A vehicle, and somebody who watches it."""
    network = MemoryNetwork()
    with network.transport() as car, network.transport() as office:
        watching = Watching(office)
        with Publisher(Loop(), SETTINGS, transport=car, rate=40.0) as publisher:
            watching.receiver.start()
            assert eventually(lambda: len(watching.frames) > 5)
            yield publisher, watching
            watching.receiver.close()


@pytest.mark.sweep
def test_one_that_was_asked_for_comes_though_frames_decode_meanwhile(ends):
    _, watching = ends
    for _ in range(3):
        before = len(watching.keys)
        watching.receiver.request_key()
        assert eventually(lambda before=before: len(watching.keys) > before)


@pytest.mark.sweep
def test_whoever_asks_just_after_one_has_come_gets_another(ends):
    """That one is still to be decoded, but whoever asks has not seen it."""
    publisher, watching = ends
    asked: list[int] = []

    def ask_once() -> None:
        if not asked:
            asked.append(watching.keys[-1])
            watching.receiver.request_key()

    for _ in range(3):
        asked.clear()
        watching.at_key = ask_once
        publisher.request_key()
        assert eventually(lambda: asked and watching.keys[-1] > asked[0])

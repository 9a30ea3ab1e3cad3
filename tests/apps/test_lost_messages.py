"""A lost message costs itself: whatever else arrives can be decoded, without a key frame for it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from itertools import product

import pytest

from lidarcodec.apps.publisher.publisher import Publisher
from lidarcodec.apps.receiver.receiver import Receiver
from lidarcodec.settings import StreamSettings
from lidarcodec.transport.keys import StreamKeys
from lidarcodec.transport.memory import MemoryNetwork
from tests.apps.streams import Loop
from tests.faults.between import Between, Harm
from tests.sweeps import sampled
from tests.transport.test_contract import eventually

KEYS = StreamKeys()
LONG_WAY = {"delay_s": 0.05, "jitter_s": 0.02}


@contextmanager
def received(settings: StreamSettings, harm: Harm) -> Iterator[tuple[Publisher, Receiver, Between, list[int]]]:
    """A publisher, a receiver behind what harms messages, and the indices of the frames that it gets."""
    near, far, indices = MemoryNetwork(), MemoryNetwork(), list[int]()
    with near.transport() as car, near.transport() as here, far.transport() as there, far.transport() as office:
        between = Between(KEYS, here, there, harm)
        receiver = Receiver(
            KEYS, "office", lambda frame: indices.append(frame.index), lambda _: None, lambda: None, transport=office
        )
        with Publisher(Loop(), settings, transport=car, rate=20.0) as publisher:
            receiver.start()
            try:
                assert eventually(lambda: len(indices) > 10)
                between.begin()
                yield publisher, receiver, between, indices
            finally:
                receiver.close()
                between.close()


@pytest.mark.parametrize(
    ("codec", "way"), sampled(product(["predictive", "pcodec"], [LONG_WAY, {}]), [("predictive", LONG_WAY)])
)
def test_what_arrives_is_decoded_without_key_frames(codec, way):
    own = {"mask_history": True} if codec == "pcodec" else {}
    settings = StreamSettings(codec=codec, codec_settings=own, key_interval=100_000)
    with received(settings, Harm(loss=0.2, **way)) as (publisher, receiver, between, indices):
        before = publisher.status()["key_frames"]
        begun = len(indices)
        assert eventually(lambda: between.dropped >= 4 and len(indices) > begun + 12)
        errors, status = receiver.errors, publisher.status()
    assert not errors
    assert status["key_frames"] == before


def test_a_lost_picture_is_answered_by_one_that_needs_no_other():
    settings = StreamSettings(codec="h264", key_interval=100_000)
    with received(settings, Harm(loss=0.2)) as (publisher, receiver, between, indices):
        begun = len(indices)
        assert eventually(lambda: between.dropped >= 4 and len(indices) > begun + 12)
        errors, status = receiver.errors, publisher.status()
    assert errors["missing_references"] <= between.dropped
    assert status["key_frames"] >= 4

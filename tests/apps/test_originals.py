"""Originals: what is compared is what was coded, and it stays on the machine."""

from __future__ import annotations

import numpy as np
import pytest

from lidarcodec.apps.once import Once
from lidarcodec.apps.publisher.originals import Originals
from lidarcodec.apps.publisher.publisher import Publisher
from lidarcodec.apps.vehicle import SensorPlan, Vehicle
from lidarcodec.errors import SettingsError
from lidarcodec.pipeline import StreamDecoder, frames_of
from lidarcodec.settings import StreamSettings
from lidarcodec.transport import Endpoints
from lidarcodec.transport.keys import StreamKeys
from lidarcodec.wire import unpack
from tests.apps.in_memory import live, publisher
from tests.apps.streams import Loop

COARSE = StreamSettings(codec="pcodec", max_error_m=0.05, reduction="columns:2")


@pytest.fixture(scope="module")
def world():
    """The ranges of every turn of the source."""
    source = Loop(1)
    return next(frames_of(source.packets(), source.sensor)).range


def test_a_frame_comes_whole_beside_its_coarse_copy_with_the_same_stream_and_index(network, world):
    inbox = network.end().inbox("lidarcodec/v1/vehicle/lidar/original")
    with publisher(network, settings=COARSE, original=True) as one, live(network) as stream:
        coded = [stream.next(60) for _ in range(3)]
        message = unpack(inbox.receive())
        inbox.close()
    (frame,) = StreamDecoder().decode(message)
    assert message.stream_id == one.stream_id
    assert np.array_equal(frame.range, world)
    assert not np.array_equal(coded[-1].range, world)


def test_what_nobody_receives_is_not_even_packed(network):
    source = Loop(1)
    frame = next(frames_of(source.packets(), source.sensor))
    originals = Originals(StreamKeys(), 7, Once(None))
    originals.declare(network.end())
    originals.offer(frame)
    inbox = network.end().inbox(StreamKeys().original)
    originals.offer(frame.with_(index=frame.index + 1))
    assert unpack(inbox.receive()).frame_index == frame.index + 1
    inbox.close()
    originals.close()


@pytest.mark.parametrize(
    ("endpoints", "local"),
    [
        ({}, True),
        ({"connect": "tcp/127.0.0.1:7447"}, True),
        ({"connect": "tcp/[::1]:7447", "listen": "tcp/localhost:7448"}, True),
        ({"connect": "unixsock-stream//run/zenoh"}, True),
        ({"connect": "tcp/192.168.1.5:7447"}, False),
        ({"connect": "tcp/127.0.0.1.example.com:7447"}, False),
        ({"connect": ("tcp/127.0.0.1:7447", "tls/router.example:7447")}, False),
        ({"listen": "tcp/0.0.0.0:7447"}, False),
    ],
)
def test_originals_never_leave_the_machine(endpoints, local):
    given = Endpoints.of(**endpoints)
    assert given.on_this_machine == local
    if not local:
        with pytest.raises(SettingsError, match="only on this machine"):
            Publisher(Loop(1), endpoints=given, original=True)
        with pytest.raises(SettingsError, match="only on this machine"):
            Vehicle("car", [SensorPlan("roof", lambda: Loop(1), StreamSettings(), original=True)], given)


def test_a_configuration_file_may_lead_anywhere(tmp_path):
    (tmp_path / "zenoh.json5").write_text("{}")
    assert not Endpoints.of(config=tmp_path / "zenoh.json5").on_this_machine

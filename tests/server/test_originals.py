"""Original against decoded over the cloud socket: always the same frame, or none at all."""

from __future__ import annotations

import threading

import numpy as np
import pytest

from lidarcodec.pipeline import frames_of
from lidarcodec.settings import StreamSettings
from tests.apps.streams import Loop
from tests.server.live import client_module, frame, running
from tests.transport.test_contract import eventually

CLIENT = client_module()
COMPARE = "vehicle/lidar/cloud?form=range&attributes=intensity,original"
COARSE = StreamSettings(codec="pcodec", max_error_m=0.02)
ORIGINAL = 16


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    with running(tmp_path_factory.mktemp("server"), ack_limit_s=60.0) as one:
        one.hub.linger_s = 0.1
        yield one


@pytest.fixture(autouse=True)
def nobody_watches(server):
    """Frames of one vehicle are not shown to those who look at the next."""
    yield
    assert eventually(lambda: not server.hub.watches() and not comparing())


@pytest.fixture(scope="module")
def world():
    source = Loop(1)
    return next(frames_of(source.packets(), source.sensor)).range_u16


def comparing() -> bool:
    return any(one.name == "lidarcodec compare" for one in threading.enumerate())


async def compared(socket, limit: int = 200):
    """The next frame that has an original, and how many came without."""
    for without in range(limit):
        head, arrays = CLIENT.read_message(await frame(socket))
        await socket.send("ack")
        if head["flags"] & ORIGINAL:
            return head, arrays, without
    raise AssertionError("no original came")


async def test_every_frame_has_its_own_original_and_the_bound_can_be_seen_to_hold(server, world):
    with server.publisher(settings=COARSE, original=True):
        assert server.seen()
        async with server.socket(COMPARE) as socket:
            await compared(socket)
            for _ in range(3):
                head, arrays, _ = await compared(socket)
                ranges = arrays["range"].reshape(64, -1).astype(int)
                assert np.array_equal(arrays["original"].reshape(64, -1), world)
                assert len(arrays["intensity"]) == 64 * head["columns"]
                error = np.abs(ranges - world)
                assert 0 < error.max() <= 10


async def test_a_vehicle_that_sends_no_originals_is_shown_all_the_same(server):
    with server.publisher():
        assert server.seen()
        async with server.socket(COMPARE) as socket:
            for _ in range(3):
                head, arrays = CLIENT.read_message(await frame(socket))
                await socket.send("ack")
                assert not head["flags"] & ORIGINAL
                assert "original" not in arrays
                assert len(arrays["range"]) == 64 * head["columns"]


async def test_nothing_is_received_for_those_who_do_not_compare(server):
    with server.publisher(original=True):
        assert server.seen()
        async with server.socket("vehicle/lidar/cloud?form=range") as socket:
            await frame(socket)
            assert not comparing()
            async with server.socket(COMPARE) as other:
                await compared(other)
                assert comparing()
            assert eventually(lambda: not comparing())

"""Viewers get where a program finds the sensor in a map: as it said it, lost as lost, and no nonsense."""

from __future__ import annotations

import asyncio
import itertools
import json
import threading
import time

import numpy as np
import pytest

from lidarcodec.commands.localise.messages import pose_json
from lidarcodec.errors import TransportError
from lidarcodec.maps.localise.tracker import Estimate
from lidarcodec.transport.base import Priority
from lidarcodec.transport.keys import StreamKeys
from lidarcodec.transport.memory import MemoryNetwork
from lidarcodec_server.live import located
from lidarcodec_server.live.located import located_event
from tests.server.live import event, running

KEYS = StreamKeys("vehicle", "lidar")


def estimate(state="tracking", x=3.0):
    pose = np.eye(4)
    pose[0, 3] = x
    known = state == "tracking"
    covariance = np.diag([1e-4, 4e-4, 1e-4, 1e-6, 1e-6, 4e-6])
    return Estimate(5_000_000_000, state, pose if known else None, covariance if known else None, 0.5, 0.6)


async def said(sender, socket, state):
    """The first event of that state. It is said again and again: what comes soon after another may be dropped."""
    while True:
        sender.put(pose_json(estimate(state), "town", "local"))
        message = await socket.recv()
        if isinstance(message, bytes):
            await socket.send("ack")
        elif json.loads(message).get("state") == state:
            return json.loads(message)


async def test_every_viewer_gets_what_localise_says_and_then_that_it_is_lost(tmp_path):
    with running(tmp_path) as server, server.publisher():
        assert server.seen()
        sender = server.network.transport().sender(KEYS.pose("car"), Priority.STATUS)
        for path in ("vehicle/lidar/cloud", "vehicle/lidar/frames"):
            async with server.socket(path) as socket:
                await event(socket, "hello")
                sender.put(b"{}")
                got = await said(sender, socket, "tracking")
                assert (got["receiver"], got["map"], got["state"]) == ("car", "town", "tracking")
                assert (got["T_world_sensor"][3], got["sigma_m"], got["stamp_ns"]) == (
                    3.0,
                    [0.01, 0.02, 0.01],
                    5 * 10**9,
                )
                got = await said(sender, socket, "lost")
                assert got["T_world_sensor"] is got["sigma_m"] is got["sigma_deg"] is None


@pytest.mark.parametrize(
    "change",
    [
        {"state": "here"}, {"stamp_ns": 1.5}, {"stamp_ns": -1}, {"stamp_ns": True}, {"map": "m" * 65}, {"map": None},
        {"map": "a\nb"}, {"map": "a\u202eb"}, {"frame": "\u2066b"},
        {"T_world_sensor": [0.0] * 11}, {"T_world_sensor": None}, {"T_world_sensor": ["0"] * 12},
        {"T_world_sensor": [0.0] * 12}, {"T_world_sensor": [1.0, 0, 0, 0, 0, 1, 0, 0, 0, 0, -1, 0]},
        {"T_world_sensor": [9.9e7] * 12}, {"sigma_m": [0.1, -1, 0]}, {"sigma_deg": [0, 0, -1e-9]},
        {"sigma_m": [1e9, 0, 0]}, {"sigma_deg": [True, 0, 0]}, {"sigma_m": [float("nan")] * 3},
    ],
)  # fmt: skip
def test_what_is_no_pose_goes_to_nobody(change):
    fields = json.loads(pose_json(estimate(), "town", "local"))
    assert located_event("car", json.dumps(fields).encode()) is not None
    assert located_event("car", json.dumps(fields | change).encode()) is None


def located_here(told, transport=None):
    return located.Located(KEYS, transport, asyncio.get_running_loop(), told.append)


async def until(condition):
    async with asyncio.timeout(60.0):
        while not condition():
            await asyncio.sleep(0.01)


async def test_one_program_cannot_flood_and_a_ninth_is_not_heard():
    told = []
    one = located_here(told)
    say = pose_json(estimate("lost"), "town", "local")
    for _ in range(500):
        one._came(KEYS.pose("car"), say)
    for at in range(20):
        one._came(KEYS.pose(f"car-{at}"), say)
    await until(lambda: told)
    assert [len(events) for events in told] == [located.MOST_PROGRAMS]
    assert len({event["receiver"] for event in told[0]}) == located.MOST_PROGRAMS
    one._heard = dict.fromkeys(one._heard, time.monotonic() - located.FORGET_S - 1.0)
    one._came(KEYS.pose("car-19"), say)
    await until(lambda: len(told) == 2)
    assert [event["receiver"] for event in told[1]] == ["car-19"]


async def test_of_what_comes_at_once_the_newest_is_told_and_nonsense_is_not():
    told = []
    one = located_here(told)
    one._came(KEYS.pose("car"), pose_json(estimate(), "town", "local"))
    await until(lambda: told)
    for state in ("tracking", "lost"):  # 20 ms later or less
        one._came(KEYS.pose("car"), pose_json(estimate(state), "town", "local"))
        one._came(KEYS.pose("other"), b" " * 10**6)
    await until(lambda: len(told) == 2)
    assert [event["state"] for event in told[1]] == ["lost"]


async def test_poses_come_together_and_at_most_ten_times_a_second():
    told, at = [], []
    loop = asyncio.get_running_loop()
    one = located.Located(KEYS, None, loop, lambda events: (told.append(events), at.append(loop.time())))
    while len(told) < 4:
        for name in ("one", "two"):
            one._came(KEYS.pose(name), pose_json(estimate(), "town", "local"))
        await asyncio.sleep(0.005)
    assert {len(events) for events in told} == {2}
    assert min(later - before for before, later in itertools.pairwise(at)) > 0.9 * located.PERIOD_S


async def test_a_watch_that_is_closed_while_it_opens_listens_no_more():
    network = MemoryNetwork()
    transport, go, told = network.transport(), threading.Event(), []
    one = located_here(told, transport)
    listen = transport.listen

    def slow(key, handler):
        go.wait(30.0)
        return listen(key, handler)

    transport.listen = slow  # as a slow network
    loop = asyncio.get_running_loop()
    starting = loop.run_in_executor(None, one.start)
    one.close()
    go.set()
    await starting
    assert not network.transport().sender(KEYS.pose("car"), Priority.STATUS).matching


async def test_poses_come_again_if_only_they_could_not_be_received_at_first(tmp_path, monkeypatch):
    start, failed = located.Located.start, []

    def failing(self):
        if self is not first and not failed:
            failed.append(self)
            raise TransportError("the network does not answer")
        start(self)

    monkeypatch.setattr("lidarcodec_server.live.hub.MEND_S", 0.05)
    with running(tmp_path) as server, server.publisher():
        assert server.seen()
        async with server.socket("vehicle/lidar/cloud") as socket:
            await event(socket, "hello")
            (watch,) = server.hub.watches().values()
            first = watch._located
            monkeypatch.setattr(located.Located, "start", failing)
            watch.receiver.failure = TransportError("the receiver's thread has ended")
            sender = server.network.transport().sender(KEYS.pose("car"), Priority.STATUS)
            async with asyncio.timeout(60.0):
                while not failed:
                    await socket.send("ack") if isinstance(await socket.recv(), bytes) else None
                got = await said(sender, socket, "tracking")
            assert got["map"] == "town"
            assert server.hub.counts["receivers failed"] == 2

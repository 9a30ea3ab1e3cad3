"""Viewers get where a program finds the sensor in a map: as it said it, lost as lost, and no nonsense."""

from __future__ import annotations

import json

import numpy as np
import pytest

from lidarcodec.commands.localise.messages import pose_json
from lidarcodec.maps.localise.tracker import Estimate
from lidarcodec.transport.base import Priority
from lidarcodec.transport.keys import StreamKeys
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
        {"T_world_sensor": [0.0] * 11}, {"T_world_sensor": None}, {"T_world_sensor": ["0"] * 12},
        {"sigma_m": [1e9, 0, 0]}, {"sigma_deg": [True, 0, 0]}, {"sigma_m": [float("nan")] * 3},
    ],
)  # fmt: skip
def test_what_is_no_pose_goes_to_nobody(change):
    fields = json.loads(pose_json(estimate(), "town", "local"))
    assert located_event("car", json.dumps(fields).encode()) is not None
    assert located_event("car", json.dumps(fields | change).encode()) is None


def test_one_program_cannot_flood_and_a_ninth_is_not_heard(monkeypatch):
    now, told = [100.0], []
    monkeypatch.setattr(located.time, "monotonic", lambda: now[0])
    one = located.Located(KEYS, None, told.append)
    say = pose_json(estimate("lost"), "town", "local")
    for _ in range(50):
        now[0] += 0.001
        one._came(KEYS.pose("car"), say)
    assert len(told) <= 3
    for at in range(20):
        one._came(KEYS.pose(f"car-{at}"), say)
    assert len({event["receiver"] for event in told}) == located.MOST_PROGRAMS
    now[0] += located.FORGET_S + 1
    one._came(KEYS.pose("car-19"), say)
    assert told[-1]["receiver"] == "car-19"

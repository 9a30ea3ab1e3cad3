"""Vehicles that list what they like: they delete no clips of others, and hold up no fetch of others for good."""

from __future__ import annotations

import json
import time
from dataclasses import replace
from functools import partial

import pytest

from lidarcodec.apps.past.plan import Clip, Plan
from lidarcodec.errors import SourceError
from lidarcodec.recording.pieces import Piece
from lidarcodec.transport.keys import StreamKeys
from lidarcodec_server.past import fetches
from lidarcodec_server.past.clips import MAX_STAYING, Clips, Record, largest_vehicles_first, oldest_first

SIZE = 100_000


def record(number, vehicle="car-1", **about):
    clip = Clip(StreamKeys(vehicle, "roof"), number, number + 1)
    return Record(f"{number}", clip, "complete", "olga", number, size=SIZE, **about)


def listing(size, vehicle="car-x"):
    return Plan(Clip(StreamKeys(vehicle, "roof"), 5, 6), [Piece("a" * 64, 5, 6, size, 1)])


def deleted(clips, plan, done, order):
    gone = []
    clips.make_room([plan], done, lambda one: gone.append(one.id) or True, order)
    return gone


def test_a_clip_for_which_there_can_be_no_room_deletes_none(tmp_path):
    """All clips were deleted before the new one was refused as too large."""
    clips, done = Clips(tmp_path, 10 * SIZE), [record(number) for number in range(5)]
    gone = []
    with pytest.raises(SourceError, match="too large"):
        clips.make_room([listing(6 * SIZE)], done, lambda one: gone.append(one.id) or True)
    assert gone == []
    assert deleted(clips, listing(3 * SIZE), done, oldest_first) == ["0"]


def test_a_clip_that_nobody_asked_for_deletes_none_of_vehicles_that_have_less(tmp_path):
    """A vehicle can tell of any marks and any sizes: others would lose the clips that people asked for."""
    clips = Clips(tmp_path, 10 * SIZE)
    done = [record(number, f"car-{number % 3}") for number in range(9)]
    large = listing(4 * SIZE)
    with pytest.raises(SourceError, match="too large"):
        deleted(clips, large, done, partial(largest_vehicles_first, "car-x", large, done))
    small = listing(SIZE)
    assert deleted(clips, small, done, partial(largest_vehicles_first, "car-x", small, done)) == ["0"]
    own = listing(SIZE, "car-2")
    assert deleted(clips, own, done, partial(largest_vehicles_first, "car-2", own, done)) == ["2"]


def test_clips_of_marks_of_one_vehicle_have_a_limit(tmp_path):
    """A clip of a few bytes takes a folder, a place in every list, and memory of the server."""
    clips = Clips(tmp_path, 1 << 30)
    done = [record(number, stays=True) for number in range(MAX_STAYING)]
    plan = listing(1, "car-1")
    clips.check_share(done[0], plan, done[1:])
    with pytest.raises(SourceError, match="which is the limit"):
        clips.check_share(done[0], plan, done)
    clips.check_share(replace(done[0], clip=plan.clip, stays=False), plan, done)


def test_vehicles_that_send_slowly_let_others_have_their_turn(tmp_path, network, monkeypatch):
    """Four of them took all turns, for as long as they went on."""
    monkeypatch.setattr(fetches, "LONGEST_TURN_S", 0.3)
    listed = {"name": "a" * 64, "begin_ns": 0, "end_ns": 10**9, "size": 60 << 20, "frames": 1}

    def slowly(data):
        if json.loads(data)["ask"] == "pieces":
            return json.dumps({"pieces": [listed], "more": False, "until_ns": 2**62}).encode()
        time.sleep(0.05)
        return b"\x01\0\0\0\0" + bytes(1024)

    names = [f"car-{number}" for number in range(fetches.RUNNING)]
    with network.transport() as car, network.transport() as near:
        for name in names:
            car.answer(StreamKeys(name, "roof").past, slowly)
        car.answer(StreamKeys("good", "roof").past, lambda data: b'{"error": "nothing is kept"}')
        held = fetches.Fetches(Clips(tmp_path, 1 << 32), lambda: near)
        held.start()
        slow = [held.begin(Clip(StreamKeys(name, "roof"), 0, 10**9), "olga") for name in names]
        waits = held.begin(Clip(StreamKeys("good", "roof"), 0, 10**9), "olga")
        end = time.monotonic() + 30
        while held.state(waits.id)[0].state == "running" and time.monotonic() < end:
            time.sleep(0.05)
        assert held.state(waits.id)[0].reason == "the vehicle refuses: nothing is kept"
        before = [held.state(one.id)[1]["bytes_received"] for one in slow]
        while time.monotonic() < end and before == [held.state(one.id)[1]["bytes_received"] for one in slow]:
            time.sleep(0.05)
        assert before != [held.state(one.id)[1]["bytes_received"] for one in slow]  # they go on
        held.close()

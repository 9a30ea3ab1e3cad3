"""Marks of a vehicle: set, told, fetched and released over HTTP, and what one vehicle may take with them."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial

import pytest

from lidarcodec.apps.past.plan import Clip, Plan
from lidarcodec.errors import SourceError
from lidarcodec.recording.marks import Mark
from lidarcodec.recording.pieces import Piece
from lidarcodec.transport.base import Priority
from lidarcodec.transport.keys import StreamKeys
from lidarcodec_server.past import fetches, marked
from lidarcodec_server.past.clips import Clips, Record
from tests.apps.past.kept_drive import KEYS
from tests.apps.streams import START_NS
from tests.server.conftest import STREAM, until
from tests.server.past.clips import FETCHES, PAST, actions, ended, seen, span


async def test_marks_are_set_told_fetched_and_released(serving, keeping, tmp_path):
    keeping()
    mark = f"{STREAM}/marks/crash-1"
    async with serving() as client:
        await seen(client)
        made = await client.put(mark, json={**span(12, 15), "reason": "airbag"})
        assert made.status_code == 200, made.text
        told = await ended(client, f"{FETCHES}/{made.json()['fetch']['id']}")
        assert told["state"] == "complete"
        kept = (await client.get(f"{PAST}/spans")).json()
        assert kept["vehicle"][0][0] == START_NS
        assert kept["here"] == [[int(span(12, 15)["from"]), int(span(12, 15)["to"])]]
        assert [(one["name"], one["reason"]) for one in kept["marks"]] == [("crash-1", "airbag")]
        stored = json.loads((tmp_path / "ring" / "car-7_roof.marks.json").read_text())
        assert [one["name"] for one in stored["marks"]] == ["crash-1"]
        assert (await client.put(f"{STREAM}/marks/all", json={"from": "0", "to": str(2**62)})).status_code == 422
        assert (await client.delete(mark)).status_code == 204
        assert (await client.delete(mark)).status_code == 404
        assert sorted(await actions(client)) == ["mark", "mark", "mark-release", "mark-release"]


async def test_a_mark_that_a_vehicle_tells_of_is_fetched_once(serving, keeping, monkeypatch):
    monkeypatch.setattr(marked, "LOOK_S", 0.1)
    car = keeping()
    kept = car._keeper.kept
    kept.mark(Mark("status-1", START_NS, START_NS + 10**9, "worker_restarts grows", "status", START_NS))
    kept.look()
    async with serving() as client:

        async def complete():
            return [one for one in (await client.get(FETCHES)).json() if one["state"] == "complete"]

        (told,) = await until(complete)
        assert (told["by"], told["from_ns"]) == ("mark status-1", START_NS)
        kept.mark(Mark("status-2", START_NS + 10**9, START_NS + 2 * 10**9, "", "status", START_NS))
        kept.look()

        async def both():
            return len(await complete()) == 2

        await until(both)
        assert await actions(client) == []


async def test_vehicles_that_do_not_answer_are_asked_for_their_marks_less_and_less(serving, network, monkeypatch):
    """Each of 16 sensors of one vehicle made all others wait at every look, for 5 s."""
    monkeypatch.setattr(marked, "LOOK_S", 0.01)
    asked = {"silent": 0, "whole": 0}
    with network.transport() as car:

        def tell(sensor, marks):
            text = {"past": {"marks": 1, "marked_ns": marks}}
            car.sender(StreamKeys("car-9", sensor).status, Priority.STATUS).put(json.dumps(text).encode())

        def answer(sensor, data):
            asked[sensor] += 1
            tell("whole", asked["whole"] + 1)
            return b"?" if sensor == "silent" else b'{"marks": []}'

        for sensor in asked:
            keys = StreamKeys("car-9", sensor)
            car.token(keys.alive)
            car.answer(keys.past, partial(answer, sensor))
        async with serving():

            async def often():
                for sensor in asked:
                    tell(sensor, asked["whole"] + 1)
                return asked["whole"] > 60

            await until(often)
    assert 2 <= asked["silent"] <= 8


def waiting_fetches(folder, network):
    """Fetches none of which begins."""
    return fetches.Fetches(Clips(folder, 1 << 20), network.transport)


def test_a_vehicle_that_tells_of_many_marks_leaves_places_to_others(tmp_path, network):
    """One vehicle took all of them, so nobody could fetch anything, and no mark of another one was."""
    held = waiting_fetches(tmp_path, network)
    clips = [Clip(StreamKeys(f"car-{car}", "roof"), at, at + 1) for car in range(9) for at in range(9)]
    refused = []
    for clip in clips:
        try:
            held.begin(clip, f"mark m-{clip.from_ns}", stays=True)
        except fetches.TooManyFetchesError:
            refused.append(clip.keys.vehicle)
    assert refused.count("car-0") == 1
    assert len(held.all()) == fetches.MAX_OF_MARKS < fetches.MAX_WAITING
    held.begin(Clip(KEYS, 0, 1), "olga")


def test_clips_of_marks_of_one_vehicle_do_not_take_the_room_of_others(tmp_path, network):
    held = waiting_fetches(tmp_path, network)
    staying = [
        Record(f"{n}", Clip(KEYS, n, n + 1), "complete", "mark m", n, size=100_000, stays=True) for n in range(2)
    ]
    plan = Plan(Clip(KEYS, 5, 6), [Piece("a" * 64, 5, 6, 100_000, 1)])
    with pytest.raises(SourceError, match="all that one vehicle may have"):
        held._clips.check_share(staying[0], plan, staying)
    other = replace(staying[0], clip=Clip(StreamKeys("car-8", "roof"), 5, 6))
    held._clips.check_share(other, plan, staying)
    held._clips.check_share(replace(staying[0], stays=False), plan, staying)

"""Clips of what a vehicle kept, over HTTP: here, on their way, cancelled, and after a restart of the server."""

from __future__ import annotations

import asyncio
import io
import json
import re
import time

import pytest

from lidarcodec.apps.past.plan import Clip
from lidarcodec.recording import RecordingReader
from lidarcodec.wire import peek
from lidarcodec_server.past import fetches
from lidarcodec_server.past.clips import MAX_GAPS, Clips, Record, few
from lidarcodec_server.tokens import create_token
from tests.apps.past.kept_drive import KEYS, big, kept
from tests.apps.streams import START_NS
from tests.server.conftest import STREAM, until
from tests.server.past.clips import FETCHES, PAST, actions, ended, seen, span


async def test_a_clip_is_fetched_once_and_then_here(serving, keeping):
    keeping()
    async with serving() as client:
        await seen(client)
        first = await client.get(PAST, params=span(12, 27))
        assert first.status_code == 202, first.text
        where = first.headers["location"]
        assert where == f"{FETCHES}/{first.json()['id']}"
        told = await ended(client, where)
        assert (told["state"], told["reason"], told["progress"]) == ("complete", None, None)
        clip = await client.get(told["clip"])
        assert clip.status_code == 200
        assert len(clip.content) == told["size_bytes"]
        found = [data for _, data in RecordingReader(io.BytesIO(clip.content)).messages()]
        assert found == [big(number) for number in range(10, 30)]
        part = await client.get(PAST, params=span(12, 27), headers={"Range": "bytes=0-7"})
        assert (part.status_code, part.content) == (206, b"\x89MCAP0\r\n")
        assert await actions(client) == ["fetch"], "exactly one entry: the second request changed nothing"


async def test_a_page_of_another_site_begins_no_fetch(serving, keeping):
    """It led an operator's browser there: a clip was fetched, and if there was no room, the oldest one was deleted."""
    keeping()
    async with serving() as client:
        await seen(client)
        for site in ("cross-site", "same-site"):
            led = {"Sec-Fetch-Site": site, "Sec-Fetch-Mode": "navigate", "Sec-Fetch-Dest": "document"}
            assert (await client.get(PAST, params=span(12, 27), headers=led)).status_code == 403
        assert (await client.get(FETCHES)).json() == []


async def test_a_clip_is_played_as_a_stream_and_stopped_again(serving, keeping):
    keeping(lambda folder: kept(folder, 12))
    async with serving() as client:
        await seen(client)
        where = (await client.get(PAST, params=span(0, 9))).headers["location"]
        assert (await client.post(f"{FETCHES}/20261126T120000Z-000000/play", json={})).status_code == 404
        name = (await ended(client, where))["id"]
        played = await client.post(f"{where}/play", json={"loop": True})
        assert played.status_code == 201, played.text
        assert (played.json()["vehicle"], played.json()["sensor"]) == (f"playback-{name}", "roof")
        assert (await client.post(f"{where}/play", json={})).status_code == 409
        assert (await client.get(where)).json()["playing"]["loop"] is True
        assert (await client.delete(where)).status_code == 409, "it is read again at each loop"
        assert (await client.delete(f"/api/v1/recordings/{name}/play")).status_code == 204
        assert (await client.get(where)).json()["playing"] is None
        assert (await client.delete(where)).status_code == 200


async def test_a_clip_that_is_played_is_neither_deleted_nor_pushed_out(serving, keeping):
    keeping()
    async with serving(max_past_bytes=5 * 2**20) as client:
        await seen(client)
        where = (await client.get(PAST, params=span(0, 19))).headers["location"]
        name = (await ended(client, where))["id"]
        fetched = client.app.state.fetches
        _, give_back = fetched.borrow(fetched.state(name)[0])  # as a player and a download do
        refused = await client.delete(where)
        assert (refused.status_code, refused.json()["type"]) == (409, "urn:lidarcodec:problem:busy")
        other = (await client.get(PAST, params=span(20, 39))).headers["location"]
        assert "is too large" in (await ended(client, other))["reason"]
        assert (await client.get(PAST, params=span(0, 19))).status_code == 200
        give_back()
        other = (await client.get(PAST, params=span(20, 39))).headers["location"]
        assert (await ended(client, other))["state"] == "complete"
        assert (await client.get(where)).status_code == 404, "it made room"


async def test_what_is_here_is_told_without_what_the_vehicle_did_not_keep(serving, keeping):
    keeping()
    async with serving() as client:
        await seen(client)
        where = (await client.get(PAST, params=span(-100, 27))).headers["location"]
        assert (await ended(client, where))["state"] == "complete"
        ((begin, end),) = (await client.get(f"{PAST}/spans")).json()["here"]
        assert begin == START_NS, "the first frame that was kept, ten seconds later than asked for"
        assert end == int(span(0, 27)["to"])


async def test_the_same_request_joins_the_running_fetch_and_it_goes_on_after_a_restart(serving, keeping, monkeypatch):
    monkeypatch.setattr(fetches, "TURN_S", 0.3)
    car = keeping()
    async with serving() as client:
        await seen(client)
        car.stop()  # away; the fetch waits for it
        begun = [(await client.get(PAST, params=span(0, 30))).headers["location"] for _ in range(3)]
        assert len(set(begun)) == 1
        told = (await client.get(begun[0])).json()
        assert told["state"] == "running"
        assert told["progress"]["bytes_done"] == 0
    keeping()
    async with serving() as client:
        assert [one["id"] for one in (await client.get(FETCHES)).json()] == [told["id"]]
        assert (await ended(client, begun[0]))["state"] == "complete"
        assert (await client.get(PAST, params=span(0, 30))).status_code == 200


async def test_a_cancelled_fetch_is_over_and_leaves_nothing(serving, keeping, config):
    car = keeping()
    async with serving() as client:
        await seen(client)
        car.stop()
        where = (await client.get(PAST, params=span(0, 50))).headers["location"]
        assert (await client.delete(where)).status_code == 200
        assert (await ended(client, where))["state"] == "cancelled"
        assert (await client.delete(where)).status_code == 200, "the second time it is forgotten"
        assert (await client.delete(where)).status_code == 404
        assert (await actions(client)).count("fetch-cancel") == 3
    assert not [path for path in config.past.rglob("*") if path.is_file()]


async def test_what_another_clip_brought_is_taken_from_there(serving, keeping):
    car = keeping()
    async with serving() as client:
        await seen(client)
        await ended(client, (await client.get(PAST, params=span(0, 29))).headers["location"])
        where = (await client.get(PAST, params=span(0, 39))).headers["location"]
        told = await ended(client, where)
        assert told["state"] == "complete"
        clip = await client.get(told["clip"])
        indices = [peek(data).frame_index for _, data in RecordingReader(io.BytesIO(clip.content)).messages()]
        assert indices == list(range(40))
        assert car.status()["past"]["stopped"] is None


@pytest.mark.parametrize(
    ("query", "field"),
    [
        ({"to": "5"}, "from"),
        ({"from": "yesterday", "to": "5"}, "from"),
        ({"from": "7", "to": "5"}, "to"),
        ({"from": "0", "to": str(10**18)}, "to"),
        ({"from": "0", "to": str(2**63)}, "to"),
        ({"from": "0", "to": "5", "quality": "base"}, "quality"),
    ],
)
async def test_what_cannot_be_fetched_is_a_problem(serving, vehicle, query, field):
    vehicle()
    async with serving() as client:
        await seen(client)
        answer = await client.get(PAST, params=query)
        assert answer.status_code == 422
        assert answer.headers["content-type"] == "application/problem+json"
        assert answer.json()["field"] == field
        assert (await client.get("/api/v1/streams/car-7/other/past", params=span(0, 5))).status_code == 404
        assert (await client.get(f"{FETCHES}/../secret")).status_code in (404, 422)


async def test_a_clip_says_what_the_vehicle_did_not_keep_of_it_also_after_a_restart(serving, keeping, config):
    keeping()
    asked = {"from": str(START_NS - 18 * 10**9), "to": span(0, 19)["to"]}
    gap = [int(asked["from"]), START_NS]
    async with serving() as client:
        await seen(client)
        where = (await client.get(PAST, params=asked)).headers["location"]
        told = await ended(client, where)
        assert (told["state"], told["gaps"], told["missing_frames"]) == ("complete", [gap], 0)
        assert (await client.get(f"{PAST}/spans")).json()["here"] == [[START_NS, int(asked["to"])]]
    async with serving() as client:
        assert (await client.get(where)).json()["gaps"] == [gap]
    about = config.past / told["id"] / "about.json"
    stored = json.loads(about.read_text())
    for change in ({"gaps": [[5, 7]]}, {"gaps": "all"}):
        about.write_text(json.dumps(stored | change))
        assert not Clips(config.past, 1).records(), "damaged"
    del stored["gaps"]  # of an earlier version
    about.write_text(json.dumps(stored))
    assert [list(one) for one in Clips(config.past, 1).records()[0].gaps] == [gap]


def test_a_clip_with_many_gaps_never_says_that_it_has_more_than_it_has():
    clip = Clip(KEYS, 0, 1000)
    some = Record("x", clip, "complete", "me", 0, gaps=few([(0, 10), (20, 30), (900, 1000)]))
    assert some.spans() == [(10, 20), (30, 900)]
    many = Record("x", clip, "complete", "me", 0, gaps=few([(4 * at, 4 * at + 2) for at in range(200)]))
    assert len(many.gaps) == MAX_GAPS
    assert all(4 * at + 1 not in range(*one) for one in many.spans() for at in range(200))
    assert many.spans()[-1] == (798, 1000)


async def test_a_vehicle_that_kept_nothing_of_it_is_told(serving, keeping):
    keeping()
    async with serving() as client:
        await seen(client)
        where = (await client.get(PAST, params={"from": "1000", "to": "2000"})).headers["location"]
        told = await ended(client, where)
        assert told["state"] == "failed"
        when = r"ask for one from 20\d\d-[^ ]*Z to 20\d\d-[^ ]*Z(, with gaps)?"
        assert re.fullmatch(
            rf"the vehicle has nothing from this time: ({when}|it has kept nothing yet)", told["reason"]
        )
        again = await client.get(PAST, params={"from": "1000", "to": "2000", "as": "fetch"})
        assert again.status_code == 202
        assert again.json()["id"] != told["id"], "what failed can be tried again"


async def test_clips_beyond_the_limit_push_out_the_oldest_and_never_exceed_it(serving, keeping):
    keeping()
    async with serving(max_past_bytes=5 * 2**20) as client:
        await seen(client)
        for first in (0, 20):
            where = (await client.get(PAST, params=span(first, first + 19))).headers["location"]
            assert (await ended(client, where))["state"] == "complete"
        assert [one["from_ns"] for one in (await client.get(FETCHES)).json()] == [int(span(20, 39)["from"])]
        where = (await client.get(PAST, params=span(0, 55))).headers["location"]
        assert "is too large" in (await ended(client, where))["reason"]


async def test_a_client_gets_the_newest_fetches_of_its_stream_and_not_those_of_the_whole_fleet(serving, keeping):
    car = keeping()
    async with serving() as client:
        await seen(client)
        names = []
        for first in (0, 10, 20):
            where = (await client.get(PAST, params=span(first, first + 5))).headers["location"]
            names.append((await ended(client, where))["id"])
        car.stop()
        old = (await client.get(PAST, params=span(30, 35))).json()["id"]
        cancelled = (await client.get(PAST, params=span(40, 45))).json()["id"]
        await client.delete(f"{FETCHES}/{cancelled}")

        async def ids(**query):
            return {one["id"] for one in (await client.get(FETCHES, params=query)).json()}

        await until(lambda: states(client, cancelled))
        mine = {"vehicle": "car-7", "sensor": "roof", "state": ["running", "complete", "failed"]}
        assert await ids(**mine) == {*names, old}
        assert await ids(**mine, limit=1) == {names[2], old}, "what runs is always told"
        assert await ids(**mine | {"sensor": "front"}) == set()
        assert await ids(vehicle="car-8") == set()
        assert (await client.get(FETCHES, params={"state": "lost"})).status_code == 422


async def states(client, name):
    """Whether a fetch was cancelled."""
    return (await client.get(f"{FETCHES}/{name}")).json()["state"] == "cancelled"


async def test_a_clip_that_is_here_can_be_told_without_its_bytes(serving, keeping):
    keeping()
    async with serving() as client:
        await seen(client)
        begun = await client.get(PAST, params=span(0, 9) | {"as": "fetch"})
        assert begun.status_code == 202
        await ended(client, begun.headers["location"])
        told = await client.get(PAST, params=span(0, 9) | {"as": "fetch"})
        assert (told.status_code, told.json()["id"], told.json()["state"]) == (200, begun.json()["id"], "complete")


async def test_old_knowledge_of_a_vehicle_has_its_age_and_pages_of_vehicles_that_are_away_take_no_place_of_settings(
    serving, keeping
):
    car = keeping()
    async with serving() as client:
        await seen(client)
        first = (await client.get(f"{PAST}/spans")).json()
        assert first["vehicle"][0][0] == START_NS
        assert first["age_s"] < 10
        car.stop()
        await asyncio.sleep(0.1)
        last = (await client.get(f"{PAST}/spans")).json()
        assert last["vehicle"] == first["vehicle"]
        assert last["age_s"] >= first["age_s"] + 0.1


async def test_viewers_get_clips_that_are_here_and_begin_nothing(serving, keeping):
    keeping()
    async with serving() as client:
        await seen(client)
        await ended(client, (await client.get(PAST, params=span(0, 9))).headers["location"])
        viewer = {"Authorization": f"Bearer {create_token(client.app.state.service.store, 'anna', 'viewer')}"}
        assert await until(lambda: refused(client))
        assert (await client.get(PAST, params=span(0, 9), headers=viewer)).status_code == 200
        assert (await client.get(PAST, params=span(0, 19), headers=viewer)).status_code == 403
        assert (await client.put(f"{STREAM}/marks/x", json=span(0, 9), headers=viewer)).status_code == 403
        assert (await client.get(PAST, params=span(0, 9))).status_code == 401


async def refused(client):
    """Whether a token is needed by now."""
    return (await client.get(STREAM)).status_code == 401


def test_the_stream_of_the_ring_is_the_one_asked_for():
    assert f"/api/v1/streams/{KEYS.vehicle}/{KEYS.sensor}" == STREAM
    assert time.time_ns() > START_NS

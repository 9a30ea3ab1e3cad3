"""What comes over the network may be anybody's: nothing of it may hurt the server or whoever reads what it tells on."""

from __future__ import annotations

import asyncio
import json
import threading
import time

import pytest

from lidarcodec.errors import SettingsError
from lidarcodec.settings import StreamSettings
from lidarcodec.transport.base import Priority
from lidarcodec.transport.keys import StreamKeys
from lidarcodec.untrusted.json import JsonRefusedError
from lidarcodec_server.fleet.desired import overlaid, wanted_with
from lidarcodec_server.fleet.fleet import Fleet
from lidarcodec_server.schemas import StreamAnswer
from lidarcodec_server.told import MAX_STATUS_BYTES, known_settings, read_status
from tests.server.conftest import STREAM, until

KEYS = StreamKeys("car-7", "roof")
HOSTILE = [
    b"",
    b"{",
    b"[]",
    b"null",
    b"7",
    b"\xff\xfe",
    b"[" * 50_000,
    b'{"a":' * 5_000,
    b'{"fps": NaN}',
    b'{"fps": 1e999}',
    b'{"x": "\\ud800"}',
    b'{"x": "' + b"y" * MAX_STATUS_BYTES + b'"}',
    b'{"n": ' + b"1" * 5000 + b"}",
]


@pytest.mark.parametrize("data", HOSTILE, ids=lambda data: data[:12].decode("latin-1"))
def test_what_is_no_status_changes_nothing(data):
    with pytest.raises(JsonRefusedError):
        read_status(data)
    fleet = Fleet()
    fleet.changed(KEYS, alive=True)
    assert fleet.told(KEYS, data) is False
    assert fleet.get(KEYS).status is None
    assert fleet.refused == 1


@pytest.mark.parametrize("settings", [None, 5, [], "x", {"codec": 5}, {"max_error_m": -1}, {"key_interval": True}])
def test_settings_that_are_none_are_not_known(settings):
    assert known_settings(settings) is None
    fleet = Fleet()
    fleet.changed(KEYS, alive=True)
    fleet.told(KEYS, json.dumps({"settings": settings}).encode())
    assert fleet.get(KEYS).settings is None


def test_what_a_newer_vehicle_has_beyond_ours_is_left_out():
    values = StreamSettings(codec="zstd").model_dump() | {"colour": "red"}
    assert known_settings(values) == StreamSettings(codec="zstd")


def test_a_status_without_a_token_makes_no_stream():
    fleet = Fleet()
    assert fleet.told(KEYS, b'{"stream_id": "a"}') is False
    assert fleet.streams() == []


def test_another_start_of_a_publisher_is_noticed_without_its_token_going():
    fleet = Fleet()
    fleet.changed(KEYS, alive=True)
    seen = [fleet.told(KEYS, json.dumps({"stream_id": start}).encode()) for start in ("a", "a", "b", "b", 5, "b")]
    assert seen == [False, False, True, False, True, False]


@pytest.mark.parametrize(("starts", "told"), [("abab", ["two_publishers"]), ("aabbb", []), ("abcd", [])])
def test_two_publishers_of_one_name_are_a_warning_and_one_that_was_started_again_is_none(starts, told):
    """Else an operator changes one vehicle and looks at the figures of another."""
    fleet = Fleet()
    fleet.changed(KEYS, alive=True)
    for start in starts:
        fleet.told(KEYS, json.dumps({"stream_id": start}).encode())
    assert [one.code for one in StreamAnswer.of(fleet.get(KEYS)).warnings] == told


def test_a_status_that_left_before_a_change_does_not_undo_it():
    fleet = Fleet()
    fleet.changed(KEYS, alive=True)
    fleet.answered(KEYS, StreamSettings(codec="zstd"))
    fleet.told(KEYS, json.dumps({"settings": StreamSettings(codec="raw").model_dump()}).encode())
    assert fleet.get(KEYS).settings.codec == "zstd"


async def test_hostile_vehicles_hurt_nobody(serving, network, vehicle):
    """Tokens, statuses and answers that are none, from a car that claims to be one; the other car works."""
    answers = iter(HOSTILE * 3)
    with network.transport() as bad:
        sender = bad.sender(KEYS.status, Priority.STATUS)
        bad.answer(KEYS.control_get, lambda data: next(answers, b"{}"))
        bad.answer(KEYS.control_set, lambda data: b'{"applied": {"codec": 5}, "first_frame": "soon"}')
        bad.answer(KEYS.control_keyframe, lambda data: b'{"first_frame": -1e99}')
        tokens = [
            bad.token(key) for key in (KEYS.alive, "lidarcodec/v1/a b/c/alive", f"lidarcodec/v1/{'x' * 65}/c/alive")
        ]
        for data in HOSTILE:
            sender.put(data)
        fits_no_field = json.dumps({"fps": 10**19, "kbps": -(10**19), "frames": 10**19}).encode()
        async with serving(answer_s=0.5, changes_per_second=1000.0, burst=100) as client:

            async def seen():
                return [one["vehicle"] for one in (await client.get("/api/v1/streams")).json()] == ["car-7"]

            await until(seen)
            sender.put(fits_no_field)

            async def taken():
                return (await client.get(STREAM)).json()["status"] is not None

            await until(taken)
            for _ in range(5):
                assert (await client.get(f"{STREAM}/settings")).status_code == 200
            assert (await client.patch(f"{STREAM}/settings", json={"codec": "zstd"})).status_code == 202
            assert (await client.post(f"{STREAM}/keyframe")).status_code == 503
            assert (await client.get("/metrics")).status_code == 200
            good = vehicle(name="car-8")

            async def works():
                answer = await client.patch("/api/v1/streams/car-8/roof/settings?prepare=true", json={"codec": "zstd"})
                return answer.status_code == 200

            assert await until(works)
            assert good.settings.codec == "zstd"
        for token in tokens:
            token.close()


async def test_the_end_does_not_wait_for_a_vehicle_that_does_not_answer(serving, network):
    asked, hung = threading.Event(), threading.Event()

    def hang(data):
        asked.set()
        hung.wait(60)

    with network.transport() as car:
        car.answer(KEYS.control_get, lambda data: json.dumps({"settings": StreamSettings().model_dump()}).encode())
        car.answer(KEYS.control_set, hang)
        async with serving(answer_s=50.0) as client:
            await client.patch(f"{STREAM}/settings?prepare=true", json={"codec": "zstd"})
            car.token(KEYS.alive)
            assert await asyncio.to_thread(asked.wait, 20)
            begin = time.monotonic()
        assert time.monotonic() - begin < 30
        hung.set()


def test_settings_that_nobody_set_stay_those_of_the_command_line():
    line = StreamSettings(codec="zstd", codec_settings={"level": 5}, key_interval=20)
    want = wanted_with({}, {"key_interval": 9}, line)
    assert want == {"key_interval": 9, "codec": "zstd"}
    assert overlaid(want, line) == line.changed(key_interval=9).model_dump()
    other = StreamSettings(codec="raw", intensity="off")
    assert overlaid(want, other) == {**other.model_dump(), "codec": "zstd", "codec_settings": {}, "key_interval": 9}
    assert overlaid({}, line) is None


def test_a_new_codec_drops_what_was_set_for_the_one_before():
    want = wanted_with({"codec": "jpeg", "codec_settings": {"quality": 30}}, {"codec": "zstd"}, None)
    assert want == {"codec": "zstd"}
    kept = wanted_with({"codec": "jpeg", "codec_settings": {"quality": 30}}, {"key_interval": 5}, None)
    assert kept == {"codec": "jpeg", "codec_settings": {"quality": 30}, "key_interval": 5}
    with pytest.raises(SettingsError):
        wanted_with({"max_error_m": 0.1, "codec": "pcodec"}, {"codec": "jpeg"}, None)


def test_a_stream_that_was_left_out_comes_in_when_there_is_room() -> None:
    fleet, late = Fleet(max_streams=1), StreamKeys("car-8", "roof")
    assert fleet.changed(KEYS, alive=True)
    assert not fleet.changed(late, alive=True)
    assert not fleet.told(late, b'{"stream_id": "1"}')
    fleet.changed(KEYS, alive=False)
    assert not fleet.told(StreamKeys("nobody", "roof"), b'{"stream_id": "1"}')
    assert fleet.told(late, b'{"stream_id": "1"}')
    assert [(one.keys, one.alive) for one in fleet.streams()] == [(late, True)]
    assert not fleet.told(late, b'{"stream_id": "1"}')


def test_a_stream_that_was_left_out_and_went_does_not_come_in() -> None:
    fleet, late = Fleet(max_streams=1), StreamKeys("car-8", "roof")
    fleet.changed(KEYS, alive=True)
    fleet.changed(late, alive=True)
    fleet.changed(late, alive=False)
    fleet.changed(KEYS, alive=False)
    assert not fleet.told(late, b'{"stream_id": "1"}')
    assert fleet.get(late) is None

"""Changing a stream: what an operator sets has to reach the vehicle, whole, now or when it comes, and be on record."""

from __future__ import annotations

import asyncio
import json

import pytest

from lidarcodec.settings import StreamSettings
from lidarcodec.transport.keys import StreamKeys
from lidarcodec_server.fleet import control
from tests.server.conftest import STREAM, until


async def there(client):
    """Wait until the vehicle is seen."""

    async def alive():
        answer = await client.get(STREAM)
        return answer.status_code == 200 and answer.json()["alive"]

    return await until(alive)


async def applied(client, **wanted):
    """Wait until the vehicle has some settings; all of them."""

    async def has():
        found = (await client.get(f"{STREAM}/settings")).json().get("applied") or {}
        return all(found.get(field) == value for field, value in wanted.items()) and found

    return await until(has)


async def audit(client):
    return (await client.get(f"{STREAM}/audit")).json()


async def test_a_change_is_applied_answered_and_audited_and_zenoh_says_the_same(serving, vehicle, network):
    car = vehicle()
    async with serving() as client:
        await there(client)
        answer = await client.patch(f"{STREAM}/settings", json={"max_error_m": 0.02, "intensity": "levels=16"})
        assert answer.status_code == 200
        body = answer.json()
        assert body["applied"] == body["desired"] == car.settings.model_dump()
        assert (body["applied"]["max_error_m"], body["applied"]["intensity"]) == (0.02, "levels=16")
        assert body["first_frame"] >= 0
        told = (await client.get(f"{STREAM}/settings")).json()
        assert told["applied"] == told["desired"] == body["applied"]
        assert told["operator"] == {"max_error_m": 0.02, "intensity": "levels=16", "codec": "pcodec"}
        with network.transport() as other:
            asked = json.loads(other.ask(StreamKeys("car-7", "roof").control_get))
        assert asked["settings"] == body["applied"]
        (entry,) = await audit(client)
        assert (entry["who"], entry["action"], entry["result"]) == ("127.0.0.1", "settings", "applied")
        assert entry["changes"] == {"max_error_m": 0.02, "intensity": "levels=16"}
        assert (entry["old"]["max_error_m"], entry["new"]) == (None, body["applied"])


async def test_a_target_that_what_is_set_keeps_out_of_reach_is_said_so_or_refused(serving, vehicle):
    """Without a word the vehicle would send two frames a second, and nobody would know why."""
    car = vehicle()
    async with serving() as client:
        await there(client)
        free = (await client.patch(f"{STREAM}/settings", json={"target_kbps": 1000})).json()
        assert free["warnings"] == []
        pinned = {"intensity": "lossless", "reduction": "all"}
        refused = await client.patch(f"{STREAM}/settings?strict=true", json=pinned)
        assert refused.status_code == 422
        assert refused.json()["type"] == "urn:lidarcodec:problem:target_out_of_reach"
        assert car.settings.intensity == "auto"
        for wrong in ("lattice:x", "lattice:1e3", "lattice:0", "lattice:"):
            body = {"reduction": wrong, "target_kbps": 400}
            refused = await client.patch(f"{STREAM}/settings?strict=true", json=body)
            assert (refused.status_code, refused.json()["field"]) == (422, "reduction"), refused.text
        body = (await client.patch(f"{STREAM}/settings", json=pinned)).json()
        (warning,) = body["warnings"]
        assert warning["code"] == "target_out_of_reach"
        assert "with intensity and reduction as set" in warning["message"]
        assert warning["remedy"].startswith("set intensity and reduction back")
        assert body["applied"]["intensity"] == "lossless", "what an operator sets is kept all the same"


async def test_a_new_codec_starts_with_its_own_default_settings(serving, vehicle):
    vehicle(StreamSettings(codec="pcodec", codec_settings={"level": 9}))
    async with serving() as client:
        await there(client)
        body = (await client.patch(f"{STREAM}/settings", json={"codec": "jpeg", "target_kbps": 4000})).json()
        assert (body["applied"]["codec"], body["applied"]["codec_settings"]) == ("jpeg", {})
        body = (
            await client.patch(f"{STREAM}/settings", json={"codec_settings": {"quality": 30}, "target_kbps": None})
        ).json()
        assert body["applied"]["codec_settings"] == {"quality": 30}
        body = (await client.patch(f"{STREAM}/settings", json={"codec": "zstd"})).json()
        assert body["applied"] == body["desired"]
        assert (body["applied"]["codec"], body["applied"]["codec_settings"]) == ("zstd", {})


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"codec": "mp3"}, "codec"),
        ({"colour": 1}, "colour"),
        ({"max_error_m": -1}, "max_error_m"),
        ({"max_error_m": True}, "max_error_m"),
        ({"max_error_m": "0.02"}, "max_error_m"),
        ({"key_interval": "5"}, "key_interval"),
        ({"target_kbps": "4000"}, "target_kbps"),
        ({"keep_points": "auto"}, "keep_points"),
        ({"codec": "jpeg", "max_error_m": 0.1}, "max_error_m"),
        ({"intensity": "off", "codec_settings": {"speed": 3}}, "codec_settings.speed"),
        ({"codec": "auto", "reduction": "lattice"}, "reduction"),
        ({"reduction": "\ud800"}, None),
        ({}, None),
    ],
)
async def test_a_change_that_is_not_allowed_is_refused_with_reason_and_field_and_nothing_changes(
    serving, vehicle, changes, field
):
    car = vehicle()
    async with serving() as client:
        await there(client)
        answer = await client.patch(
            f"{STREAM}/settings", content=json.dumps(changes), headers={"Content-Type": "application/json"}
        )
        assert answer.status_code == 422
        assert answer.headers["content-type"] == "application/problem+json"
        assert answer.json().get("field") == field
        assert answer.json()["detail"]
        assert car.settings == StreamSettings()
        assert (await client.get(f"{STREAM}/settings")).json()["operator"] == {}
        (entry,) = await audit(client)
        assert (entry["result"], entry["reason"], entry["new"]) == ("refused", answer.json()["detail"], None)


@pytest.mark.parametrize(
    "body", [b"{", b"[]", b"1e999", b'{"max_error_m": NaN}', b"[" * 30_000, b'{"a":' * 9000, b"\xff"]
)
async def test_what_is_no_json_object_is_a_problem(serving, body):
    async with serving() as client:
        answer = await client.patch(f"{STREAM}/settings", content=body, headers={"Content-Type": "application/json"})
        assert answer.status_code == 422
        assert answer.headers["content-type"] == "application/problem+json"


async def test_what_was_set_while_a_vehicle_was_away_is_applied_when_it_comes(serving, vehicle):
    async with serving() as client:
        answer = await client.patch(f"{STREAM}/settings?prepare=true", json={"codec": "zstd", "key_interval": 7})
        assert answer.status_code == 202
        assert answer.json()["applied"] is None
        assert answer.json()["desired"]["key_interval"] == 7
        assert (await client.get("/api/v1/streams")).json()[0]["alive"] is False
        vehicle(StreamSettings(intensity="off"))
        found = await applied(client, codec="zstd", key_interval=7)
        assert found["intensity"] == "off"  # nobody set it: that is the command line's

        async def audited():
            return len(await audit(client)) == 2 and await audit(client)

        last, first = await until(audited)
        assert (first["who"], first["result"]) == ("127.0.0.1", "stored")
        assert (last["who"], last["result"], last["new"]["codec"]) == ("server", "applied", "zstd")


async def test_a_vehicle_that_starts_again_gets_its_settings_back(serving, vehicle):
    car = vehicle()
    async with serving() as client:
        await there(client)
        await client.patch(f"{STREAM}/settings", json={"codec": "zstd"})
        car.stop()
        again = vehicle(StreamSettings(codec="raw"))
        await applied(client, codec="zstd")
        assert again.settings.codec == "zstd"


async def test_a_server_that_starts_again_knows_what_was_wanted(serving, vehicle):
    car = vehicle()
    async with serving() as client:
        await there(client)
        await client.patch(f"{STREAM}/settings", json={"codec": "zstd"})
    car.change(codec="raw")
    async with serving() as client:
        await applied(client, codec="zstd")
        assert car.settings.codec == "zstd"
        assert (await client.get(f"{STREAM}/settings")).json()["operator"]["codec"] == "zstd"


async def test_what_is_in_step_is_left_alone_when_a_server_starts_again(serving, vehicle):
    car = vehicle()
    async with serving() as client:
        await there(client)
        await client.patch(f"{STREAM}/settings", json={"codec": "zstd"})
    async with serving() as client:
        await applied(client, codec="zstd")
        await asyncio.sleep(0.3)
        assert [entry["who"] for entry in await audit(client)] == ["127.0.0.1"]
        assert car.settings.codec == "zstd"


async def test_what_was_set_is_forgotten_on_request_and_the_vehicle_has_its_own_at_once(serving, vehicle):
    car = vehicle()
    async with serving() as client:
        await there(client)
        changed = (await client.patch(f"{STREAM}/settings", json={"codec": "zstd", "max_error_m": 0.05})).json()
        told = (await client.delete(f"{STREAM}/settings")).json()
        assert (told["desired"], told["operator"]) == (None, {})
        assert (told["applied"]["codec"], told["applied"]["max_error_m"]) == ("pcodec", None)
        assert told["first_frame"] >= changed["first_frame"]
        assert car.settings.codec == "pcodec"
        assert (await audit(client))[0]["first_frame"] == told["first_frame"]
        assert (await client.delete(f"{STREAM}/settings")).json()["first_frame"] is None, "there was nothing to forget"
        car.stop()
        again = vehicle()
        await applied(client, codec="pcodec")
        await asyncio.sleep(0.3)
        assert again.settings.codec == "pcodec"
        assert [entry["action"] for entry in await audit(client)] == ["forget", "forget", "settings"]


async def test_a_vehicle_that_refuses_says_why_and_nothing_is_kept(serving, network):
    """A vehicle may know less than the server, or more: it has the last word."""
    keys = StreamKeys("car-7", "roof")
    with network.transport() as car:
        car.answer(keys.control_get, lambda data: json.dumps({"settings": StreamSettings().model_dump()}).encode())
        car.answer(keys.control_set, lambda data: b'{"error": "not while it rains", "field": "codec"}')
        car.token(keys.alive)
        async with serving() as client:
            await there(client)
            answer = await client.patch(f"{STREAM}/settings", json={"codec": "zstd"})
            assert answer.status_code == 422
            assert answer.json()["detail"] == "not while it rains"
            assert answer.json()["field"] == "codec"
            assert (await client.get(f"{STREAM}/settings")).json()["operator"] == {}
            (entry,) = await audit(client)
            assert (entry["result"], entry["reason"]) == ("refused", "not while it rains")


async def test_a_vehicle_that_does_not_answer_gets_the_change_later(serving, network, vehicle):
    keys = StreamKeys("car-7", "roof")
    with network.transport() as hung:
        token = hung.token(keys.alive)
        async with serving(answer_s=0.2) as client:
            await there(client)
            answer = await client.patch(f"{STREAM}/settings", json={"codec": "zstd"})
            assert answer.status_code == 202
            token.close()
            vehicle()
            await applied(client, codec="zstd")


async def test_a_vehicle_that_never_answers_does_not_fill_the_audit_log(serving, network, monkeypatch):
    monkeypatch.setattr(control, "AGAIN_S", 0.01)
    monkeypatch.setattr(control, "RARELY_S", 0.01)
    keys, asked = StreamKeys("car-7", "roof"), []
    with network.transport() as car:
        car.answer(keys.control_get, lambda data: json.dumps({"settings": StreamSettings().model_dump()}).encode())
        car.answer(keys.control_set, asked.append)
        car.token(keys.alive)
        async with serving() as client:
            await there(client)
            assert (await client.patch(f"{STREAM}/settings", json={"codec": "zstd"})).status_code == 202

            async def often():
                return len(asked) > 10

            await until(often)
            assert [entry["result"] for entry in await audit(client)] == ["stored"]


async def test_changes_of_one_stream_go_one_after_the_other(serving, vehicle):
    car = vehicle()
    async with serving(changes_per_second=1000.0, burst=100) as client:
        await there(client)
        answers = await asyncio.gather(
            *(client.patch(f"{STREAM}/settings", json={"key_interval": number}) for number in range(10, 18))
        )
        assert [answer.status_code for answer in answers] == [200] * 8
        entries = (await audit(client))[::-1]
        assert [entry["old"]["key_interval"] for entry in entries[1:]] == [
            entry["new"]["key_interval"] for entry in entries[:-1]
        ]
        assert car.settings.key_interval == entries[-1]["new"]["key_interval"]


async def test_a_key_frame_comes_on_request_and_only_from_a_vehicle_that_is_there(serving, vehicle):
    async with serving() as client:
        assert (await client.post(f"{STREAM}/keyframe")).status_code == 404
        car = vehicle()
        await there(client)
        answer = await client.post(f"{STREAM}/keyframe")
        assert answer.status_code == 200
        assert answer.json()["first_frame"] >= 0
        car.stop()

        async def away():
            return (await client.post(f"{STREAM}/keyframe")).status_code == 503

        assert await until(away)


async def test_the_audit_log_is_read_page_by_page(serving):
    async with serving(changes_per_second=1000.0, burst=100) as client:
        for number in range(1, 6):
            await client.patch(f"{STREAM}/settings?prepare=true", json={"key_interval": number})
        first = (await client.get(f"{STREAM}/audit?limit=3")).json()
        rest = (await client.get(f"{STREAM}/audit?limit=3&before={first[-1]['id']}")).json()
        assert [entry["changes"]["key_interval"] for entry in first + rest] == [5, 4, 3, 2, 1]


async def test_settings_are_kept_for_so_many_streams_only(serving):
    async with serving(max_streams=2) as client:
        answers = [
            await client.patch(f"/api/v1/streams/{car}/roof/settings?prepare=true", json={"codec": "raw"})
            for car in "abc"
        ]
        assert [answer.status_code for answer in answers] == [202, 202, 422]


async def test_a_vehicle_that_was_away_returns_to_its_own_settings_when_its_link_is_back(serving, network):
    """It was not started again, so its command line alone would not do it."""
    keys, resets, own = StreamKeys("car-7", "roof"), [], StreamSettings(codec="raw")
    answer = json.dumps({"applied": own.model_dump(), "first_frame": 7, "key": True}).encode()
    with network.transport() as car:
        car.answer(keys.control_get, lambda data: json.dumps({"settings": own.model_dump()}).encode())
        car.answer(keys.control_set, lambda data: answer)
        car.answer(keys.control_reset, lambda data: resets.append(data) or answer)
        token = car.token(keys.alive)
        async with serving() as client:
            await there(client)
            assert (await client.patch(f"{STREAM}/settings", json={"codec": "raw"})).status_code == 200
            token.close()

            async def away():
                return not (await client.get(STREAM)).json()["alive"]

            await until(away)
            told = (await client.delete(f"{STREAM}/settings")).json()
            assert (told["operator"], told["first_frame"], resets) == ({}, None, [])
            car.token(keys.alive)

            async def reset():
                return resets

            await until(reset)
            await asyncio.sleep(0.3)
            assert len(resets) == 1


async def test_settings_deleted_and_others_set_while_a_vehicle_was_away_leave_only_the_others(serving, vehicle):
    car = vehicle()
    async with serving() as client:
        await there(client)
        assert (await client.patch(f"{STREAM}/settings", json={"max_error_m": 0.05})).status_code == 200
        settings = car.settings
        car.stop()

        async def away():
            return not (await client.get(STREAM)).json()["alive"]

        await until(away)
        await client.delete(f"{STREAM}/settings")
        assert (await client.patch(f"{STREAM}/settings", json={"key_interval": 7})).status_code == 202
        vehicle(max_error_m=settings.max_error_m)  # as if it had never been away
        await applied(client, key_interval=7)
        assert (await client.get(f"{STREAM}/settings")).json()["applied"]["max_error_m"] is None


async def test_a_wrong_name_is_no_stream_unless_one_says_that_it_is_to_come(serving):
    """Settings for a name with a typing error would wait for ever, and the vehicle that was meant never gets them."""
    async with serving() as client:
        refused = await client.patch("/api/v1/streams/car-77/roof/settings", json={"codec": "zstd"})
        assert (refused.status_code, refused.json()["type"]) == (404, "urn:lidarcodec:problem:unknown-stream")
        assert "?prepare=true" in refused.json()["detail"]
        assert (await client.get("/api/v1/streams")).json() == []
        taken = await client.patch("/api/v1/streams/car-77/roof/settings?prepare=true", json={"codec": "zstd"})
        assert taken.status_code == 202
        again = await client.patch("/api/v1/streams/car-77/roof/settings", json={"codec": "raw"})
        assert again.status_code == 202, "it is known by now"


async def test_a_field_that_is_no_setting_is_refused_whatever_its_name(serving, vehicle):
    vehicle()
    async with serving() as client:
        await there(client)
        for name in ("self", "changes", "model_config"):
            for asked in ("", "?strict=true"):
                refused = await client.patch(f"{STREAM}/settings{asked}", json={name: 1})
                assert (refused.status_code, refused.json()["field"]) == (422, name)

"""What the page asks first and most: who it is, what can be set, and a line for each stream, once a second."""

from __future__ import annotations

import pytest

from lidarcodec.codecs import table as codecs
from lidarcodec.reduction import table as reductions
from lidarcodec.settings import StreamSettings
from lidarcodec.transport.base import Priority
from lidarcodec.transport.keys import StreamKeys
from lidarcodec_server.tokens import create_token
from tests.server.conftest import STREAM, until


async def test_without_tokens_everybody_here_is_an_operator(serving):
    async with serving() as client:
        told = (await client.get("/api/v1/session")).json()
    assert (told["role"], told["token_needed"], told["name"]) == ("operator", False, "127.0.0.1")


async def test_a_page_learns_that_a_token_is_needed_and_whose_it_has(serving):
    async with serving() as client:
        token = create_token(client.app.state.service.store, "anna", "viewer")
        client.app.state.service.tokens._due = 0.0  # as a second later
        told = (await client.get("/api/v1/session")).json()
        assert (told["role"], told["token_needed"], told["name"]) == (None, True, None)
        told = (await client.get("/api/v1/session", headers={"Authorization": f"Bearer {token}"})).json()
        assert (told["role"], told["name"]) == ("viewer", "anna")
        wrong = await client.get("/api/v1/session", headers={"Authorization": "Bearer lct_wrong"})
        assert wrong.status_code == 401


async def test_the_schema_of_settings_offers_what_is_allowed(serving):
    async with serving() as client:
        fields = (await client.get("/api/v1/settings")).json()["properties"]
    assert set(fields) == set(StreamSettings.model_fields)
    assert all(about["description"] for about in fields.values())
    assert fields["codec"]["enum"] == ["auto", *codecs.names()]
    for name in ("intensity", "framing"):
        for example in fields[name]["examples"]:
            StreamSettings(**{name: example})
    for example in fields["reduction"]["examples"]:
        reductions.check(StreamSettings(reduction=example))
    free = {name: about["free"] for name, about in fields.items() if "free" in about}
    assert free == {"max_error_m": None, "intensity": "auto", "reduction": "auto"}, "left to a target where not set"
    for name in fields["reduction"]["budgeted"]:
        reductions.check(StreamSettings(reduction=name, keep_points=1000))


async def test_every_setting_of_a_codec_says_what_it_does(serving):
    async with serving() as client:
        for codec in (await client.get("/api/v1/codecs")).json():
            for name, about in codec["settings_schema"]["properties"].items():
                assert about.get("description"), f"{codec['name']}: {name}"


async def test_a_line_of_the_fleet_has_what_a_list_shows_and_the_last_minute(serving, vehicle):
    async with serving() as client:
        car = vehicle(StreamSettings(codec="zstd", target_kbps=4000.0))

        async def told():
            rows = (await client.get("/api/v1/fleet?minute=true")).json()
            return rows and rows[0]["minute"] and rows

        (row,) = await until(told)
        assert (row["vehicle"], row["sensor"], row["alive"], row["codec"]) == ("car-7", "roof", True, "zstd")
        assert row["target"] == 4000
        assert row["silent_s"] < 20
        assert (row["recording"], row["playback"]) == (None, None)
        assert 1 <= len(row["minute"]) <= 60
        assert (await client.get("/api/v1/fleet")).json()[0]["minute"] is None
        car.stop()

        async def gone():
            return not (await client.get("/api/v1/fleet")).json()[0]["alive"]

        assert await until(gone)


@pytest.mark.parametrize(
    "status",
    [
        b"{}",
        b'{"rate": 7, "reports": 7, "flight": 7, "kbps": "many", "replaced": true, "ended": "no"}',
        b'{"rate": {"target_kbps": [], "reached": 1}, "reports": {"a": 7, "b": {"latency_p50_ms": "x"}}}',
        b'{"flight": {"following": {}}, "reports": {"a": {"latency_p50_ms": 12.5}}, "kbps": 1e300, "fps": 1e200}',
    ],
)
async def test_what_a_vehicle_tells_wrongly_is_left_out_of_its_line(serving, vehicle, network, status):
    async with serving() as client:
        car = vehicle()

        async def told():
            return (await client.get(STREAM)).json().get("status")

        await until(told)
        car.stop()
        other = network.transport()
        token = other.token(StreamKeys("car-7", "roof").alive)
        other.sender(StreamKeys("car-7", "roof").status, Priority.STATUS).put(status)

        async def taken():
            now = await told()
            return now is not None and now.get("fps") in (None, 1e200)

        await until(taken)
        answer = await client.get("/api/v1/fleet?minute=true")
        token.close()
    assert answer.status_code == 200, answer.text
    (row,) = answer.json()
    assert row["kbps"] is None
    assert row["reached"] is None
    assert row["latency_ms"] in (None, 12.5)


async def test_a_preset_of_a_link_is_set_with_one_patch_and_the_list_says_which_codec_it_became(serving, vehicle):
    vehicle()
    async with serving() as client:
        links = (await client.get("/api/v1/links")).json()
        assert [one["name"] for one in links] == ["1mbit", "2mbit", "5mbit", "lan"]
        (chosen,) = [one for one in links if one["label"] == "Mobile 2 Mbit/s"]

        async def there():
            rows = (await client.get("/api/v1/fleet")).json()
            return bool(rows and rows[0]["alive"])

        await until(there)
        body = (await client.patch(f"{STREAM}/settings", json=chosen["settings"])).json()
        assert chosen["settings"].items() <= body["applied"].items()

        async def measured():
            status = (await client.get(STREAM)).json()["status"] or {}
            return (status.get("codec_choice") or {}).get("budget_ms") and status

        status = await until(measured)
        assert status["settings"]["codec"] == "auto"
        row = (await client.get("/api/v1/fleet")).json()[0]
        assert row["codec"] == status["codec"] == status["codec_choice"]["codec"] != "auto"
        assert f'codec="{row["codec"]}"' in (await client.get("/metrics")).text
        assert (await client.get(f"{STREAM}/settings")).json()["refused"] is None

"""Every request that may change something stands in the audit log exactly once, done or refused."""

from __future__ import annotations

import json

import pytest

from lidarcodec_server.operations import Operation
from lidarcodec_server.refusals import Refusals
from lidarcodec_server.store.store import Store
from lidarcodec_server.tokens import Client, create_token
from tests.conftest import ROOT
from tests.server.conftest import STREAM, until

CHANGING = ("post", "put", "patch", "delete")
RATES = {"changes_per_second": 1000.0, "burst": 1000}


@pytest.fixture
def tokens(config):
    store = Store(config.database_url)
    store.open()
    made = {role: create_token(store, role, role) for role in ("viewer", "operator")}
    store.close()
    return made


def routes():
    """Method and pattern of every route that changes something; test_openapi.py keeps the document true."""
    paths = json.loads((ROOT / "docs" / "openapi.json").read_text())["paths"]
    return [(method, path) for path, methods in paths.items() for method in methods if method in CHANGING]


def entries(client, after=0):
    """The newest ten entries at most, those after an entry, newest first."""
    return [one for one in client.app.state.service.store.audit(None, 10) if one.id > after]


def last(client):
    """Id of the newest entry."""
    return max((one.id for one in entries(client)), default=0)


BODIES = [
    b"{}",
    b"",
    b'{"codec": "zstd"}',
    b'{"codec": "mp3"}',
    b'{"paused": true}',
    b"[]",
    b"{",
    b'{"x": ' + b"[" * 40 + b"]" * 40 + b"}",
    b'{"codec": "\\ud800"}',
]
PLACES = [
    {"vehicle": "car-7", "sensor": "roof", "id": "20261121T101500Z-3fa2c9", "mark": "crash-1", "segment": "0" * 24},
    {"vehicle": "nobody", "sensor": "roof", "id": "none", "mark": "crash-1", "segment": "none"},
    {"vehicle": "a b", "sensor": "x" * 70, "id": "y" * 70, "mark": "z" * 70, "segment": "s" * 70},
]


@pytest.mark.timeout(300)
async def test_every_operator_route_leaves_one_entry_whatever_becomes_of_it(serving, vehicle, tokens, tmp_path):
    """Also of a body that is no JSON, or not said to be."""
    vehicle()
    seen = set()
    async with serving(tokens["operator"], recordings=tmp_path / "recordings", **RATES) as client:

        async def there():
            return (await client.get(STREAM)).status_code == 200

        await until(there)
        found = routes()
        assert len(found) >= 9
        for method, pattern in found:
            for place in PLACES:
                for body in BODIES if place is PLACES[0] else BODIES[::4]:
                    path, before = pattern.format(**place), last(client)
                    headers = {"Content-Type": "application/json"}
                    answer = await client.request(method.upper(), path, content=body, headers=headers)
                    made = entries(client, before)
                    assert body not in BODIES[-3:] or answer.status_code == 422
                    assert len(made) == 1, (method, path, body, answer.text, made)
                    for entry in made:
                        good = ("done", "applied", "stored")
                        assert (entry.result in good) == (answer.status_code < 400), (path, entry, answer.text)
                        assert entry.who == "operator"
                        seen.add(entry.action)
        for path in ("/api/v1/streams", "/api/v1/recordings", f"{STREAM}/settings", "/api/v1/audit"):
            before = last(client)
            assert (await client.get(path)).status_code == 200
            assert entries(client, before) == []
    assert seen == {
        *("settings", "forget", "keyframe", "record", "record-stop", "record-delete"),
        *("play", "play-steer", "play-stop", "mark", "mark-release", "fetch-cancel"),
    }


@pytest.mark.parametrize("role", ["viewer", None])
async def test_who_may_change_nothing_cannot_fill_the_log(serving, tokens, role):
    async with serving(tokens.get(role), **RATES) as client:
        before = last(client)
        for method, pattern in routes():
            answer = await client.request(method.upper(), pattern.format(**PLACES[0]), json={"paused": True})
            assert answer.status_code == (403 if role else 401), pattern
        assert entries(client, before) == []


async def test_a_key_frame_is_entered_with_the_frame_that_it_begins(serving, vehicle):
    vehicle()
    async with serving() as client:

        async def asked():
            answer = await client.post(f"{STREAM}/keyframe")
            return answer.status_code == 200 and answer.json()

        answer = await until(asked)
        entry = (await client.get(f"{STREAM}/audit")).json()[0]
        assert (entry["action"], entry["result"]) == ("keyframe", "done")
        assert entry["first_frame"] == answer["first_frame"]
        whole = (await client.get("/api/v1/audit")).json()
        assert whole[0] == entry
        assert (whole[0]["vehicle"], whole[0]["sensor"]) == ("car-7", "roof")


PATHS = ["/etc/shadow", "/nowhere/at/all", "../x.lcrw", "~/x", ".ssh", "a\\b", "C:x"]


@pytest.mark.parametrize("path", PATHS)
async def test_a_setting_that_is_a_path_is_refused_with_the_same_words_whether_or_not_it_is_there(serving, path):
    async with serving() as client:
        for change in ({"weights": path}, {"deep": [{"er": path}]}):
            answer = await client.patch(
                f"{STREAM}/settings?prepare=true", json={"codec": "riddle", "codec_settings": change}
            )
            assert answer.status_code == 422
            assert answer.json()["detail"] == "a setting must be a name, not the path of a file"
            body = {"settings": {"codec": "riddle", "codec_settings": change}}
            answer = await client.post("/api/v1/recordings/20261121T101500Z-3fa2c9/play", json=body)
            assert answer.json()["detail"] == "a setting must be a name, not the path of a file"


@pytest.mark.parametrize("site", ["cross-site", "same-site"])
async def test_a_page_of_another_site_can_show_nothing_from_here(serving, site):
    """Pictures are asked for without an Origin; the browser says from where all the same."""
    async with serving() as client:
        for path in ("/api/v1/streams", f"{STREAM}/snapshot.png", "/metrics", "/"):
            for mode in ("no-cors", "cors"):
                headers = {"Sec-Fetch-Site": site, "Sec-Fetch-Mode": mode}
                assert (await client.get(path, headers=headers)).status_code == 403, path
        assert (
            await client.get("/", headers={"Sec-Fetch-Site": site, "Sec-Fetch-Mode": "navigate"})
        ).status_code == 200
        answer = await client.get("/api/v1/streams", headers={"Sec-Fetch-Site": "same-origin"})
        assert answer.status_code == 200
        assert answer.headers["cross-origin-resource-policy"] == "same-origin"
        assert "set-cookie" not in answer.headers


async def test_requests_that_come_too_soon_share_one_entry_a_minute_with_their_number(serving, tokens):
    """Each of them had none; with one each, a client that asks without end would fill the database."""
    async with serving(tokens["operator"], changes_per_second=0.01, burst=2) as client:
        before = last(client)
        answers = [await client.patch(f"{STREAM}/settings?prepare=true", json={"codec": "raw"}) for _ in range(30)]
        answers += [await client.post(f"{STREAM}/keyframe") for _ in range(10)]
        statuses = [answer.status_code for answer in answers]
        assert statuses == [202] * 2 + [429] * 38
        made = [entry for entry in (await client.get("/api/v1/audit")).json() if entry["id"] > before]
        assert [entry["result"] for entry in made] == ["refused", "stored", "stored"]
        assert made[0]["changes"] == {"requests": 38, "actions": ["keyframe", "settings"]}
        assert (made[0]["who"], made[0]["action"], made[0]["vehicle"]) == ("operator", "settings", "car-7")
        assert "changes a second" in made[0]["reason"]


def test_a_minute_later_they_have_another_entry_and_at_the_end_the_number_is_kept(config, tokens):
    clock = [0.0]
    store = Store(config.database_url)
    refusals = Refusals(store, lambda: clock[0])
    for at_s in (0.0, 1.0, 2.0, 61.0, 62.0, 63.0, 64.0):
        clock[0] = at_s
        refusals.enter(Operation(Client("ada", "operator"), "keyframe", reason="too often"))
    refusals.enter(Operation(Client("bert", "operator"), "play", reason="too often"))
    refusals.write()
    found = [(entry.who, entry.changes["requests"]) for entry in store.audit(None) if entry.result == "refused"]
    store.close()
    assert found == [("bert", 1), ("ada", 4), ("ada", 3)]


BODY_HEADERS = [
    ({"Content-Type": "text/plain"}, b"{}", 415),
    ({"Content-Type": "application/json"}, b" " * 70_000, 413),
    ({"Content-Type": "application/json"}, b'{"a": "\\u0000"}', 422),
]


@pytest.mark.parametrize(("headers", "body", "status"), BODY_HEADERS)
async def test_a_body_that_is_refused_leaves_an_entry_too(serving, tokens, headers, body, status):
    async with serving(tokens["operator"], **RATES) as client:
        for method, pattern in routes():
            before = last(client)
            path = pattern.format(**PLACES[0])
            answer = await client.request(method.upper(), path, content=body, headers=headers)
            assert answer.status_code == status, (method, path)
            (made,) = entries(client, before)
            assert made.result == "refused"
            assert made.reason == answer.json()["detail"]


def test_what_no_database_keeps_is_entered_without_it(config, tokens):
    store = Store(config.database_url)
    store.note(None, "ada", "play", {"a\x00": ["\ud800"]}, result="refused", reason="no '\udfff'")
    (entry, *_) = store.audit(None)
    store.close()
    assert (entry.changes, entry.reason) == ({"a\ufffd": ["\ufffd"]}, "no '\ufffd'")


async def test_each_act_that_the_audit_log_lacks_is_named_in_the_servers_log(serving, tokens, vehicle, caplog):
    """At most one a second was: the others were in no record at all."""
    vehicle()
    async with serving(tokens["operator"], **RATES) as client:

        async def there():
            return (await client.get(STREAM)).status_code == 200

        await until(there)
        with client.app.state.service.store._engine.begin() as connection:
            connection.exec_driver_sql("DROP TABLE audit")
        for _ in range(5):
            assert (await client.post(f"{STREAM}/keyframe", json={})).status_code < 500
    named = [line for line in caplog.messages if "could not be written to the audit log: keyframe of" in line]
    assert len(named) == 5
    assert "by operator" in named[0]

"""Every request that may change something stands in the audit log exactly once, done or refused."""

from __future__ import annotations

import pytest

from lidarcodec_server.store import Store
from lidarcodec_server.tokens import create_token
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


def routes(client):
    """Method and pattern of every route that changes something."""
    paths = client.app.openapi()["paths"]
    return [(method, path) for path, methods in paths.items() for method in methods if method in CHANGING]


def entries(client):
    return client.app.state.service.store.audit(None, 1000)


BODIES = [
    b"{}",
    b"",
    b'{"codec": "zstd"}',
    b'{"codec": "mp3"}',
    b'{"paused": true}',
    b"[]",
    b"{",
    b'{"x": ' + b"[" * 40 + b"]" * 40 + b"}",
]
PLACES = [
    {"vehicle": "car-7", "sensor": "roof", "id": "20261121T101500Z-3fa2c9"},
    {"vehicle": "nobody", "sensor": "roof", "id": "none"},
    {"vehicle": "a b", "sensor": "x" * 70, "id": "y" * 70},
]


async def test_every_operator_route_leaves_one_entry_whatever_becomes_of_it(serving, vehicle, tokens, tmp_path):
    """A body that is refused before any route is looked for is no operation."""
    vehicle()
    seen = set()
    async with serving(tokens["operator"], recordings=tmp_path / "recordings", **RATES) as client:

        async def there():
            return (await client.get(STREAM)).status_code == 200

        await until(there)
        found = routes(client)
        assert len(found) >= 9
        for method, pattern in found:
            for place in PLACES:
                for body in BODIES:
                    path, before = pattern.format(**place), len(entries(client))
                    headers = {"Content-Type": "application/json"}
                    answer = await client.request(method.upper(), path, content=body, headers=headers)
                    made = entries(client)[: len(entries(client)) - before]
                    none = body in BODIES[-2:]
                    assert not none or answer.status_code == 422
                    assert len(made) == (0 if none else 1), (method, path, body, answer.text, made)
                    for entry in made:
                        good = ("done", "applied", "stored")
                        assert (entry.result in good) == (answer.status_code < 400), (path, entry, answer.text)
                        assert entry.who == "operator"
                        seen.add(entry.action)
        for path in ("/api/v1/streams", "/api/v1/recordings", f"{STREAM}/settings", "/api/v1/audit"):
            before = len(entries(client))
            assert (await client.get(path)).status_code == 200
            assert len(entries(client)) == before
    assert seen == {
        *("settings", "forget", "keyframe", "record", "record-stop", "record-delete"),
        *("play", "play-steer", "play-stop"),
    }


@pytest.mark.parametrize("role", ["viewer", None])
async def test_who_may_change_nothing_cannot_fill_the_log(serving, tokens, role):
    async with serving(tokens.get(role), **RATES) as client:
        before = len(entries(client))
        for method, pattern in routes(client):
            answer = await client.request(method.upper(), pattern.format(**PLACES[0]), json={"paused": True})
            assert answer.status_code == (403 if role else 401), pattern
        assert len(entries(client)) == before


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
            answer = await client.patch(f"{STREAM}/settings", json={"codec": "riddle", "codec_settings": change})
            assert answer.status_code == 422
            assert answer.json()["detail"] == "a setting is a name, not a path of a file"
            body = {"settings": {"codec": "riddle", "codec_settings": change}}
            answer = await client.post("/api/v1/recordings/20261121T101500Z-3fa2c9/play", json=body)
            assert answer.json()["detail"] == "a setting is a name, not a path of a file"


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

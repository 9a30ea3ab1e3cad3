"""What a client may not do: it must not stop the server from serving the others."""

from __future__ import annotations

import asyncio
import logging
import time

import pytest

from lidarcodec_server import limits
from lidarcodec_server.limits import Limits, SparseLog, TooManyError
from lidarcodec_server.store.store import Store
from lidarcodec_server.tokens import create_token
from tests.server.conftest import STREAM

JSON = {"Content-Type": "application/json"}


async def test_a_body_that_is_too_long_is_refused_before_it_is_read(serving):
    async with serving(max_body_bytes=2000) as client:
        answer = await client.patch(f"{STREAM}/settings", content=b" " * 2001, headers=JSON)
        assert answer.status_code == 413
        assert answer.headers["content-type"] == "application/problem+json"


async def test_a_body_of_unknown_length_is_refused_where_it_becomes_too_long(serving):
    given = 0

    async def body():
        nonlocal given
        for _ in range(100):
            given += 1
            yield b" " * 1000

    async with serving(max_body_bytes=2000) as client:
        answer = await client.patch(f"{STREAM}/settings", content=body(), headers=JSON)
        assert answer.status_code == 413


async def test_a_body_that_does_not_come_is_not_waited_for(serving):
    async def body():
        yield b"{"
        await asyncio.sleep(30)

    async with serving(body_s=0.1) as client:
        answer = await client.patch(f"{STREAM}/settings", content=body(), headers=JSON)
        assert answer.status_code == 408


async def test_a_body_that_is_not_said_to_be_json_is_refused(serving):
    """A form on any web page can make a browser send text; then the browser need not ask first."""
    async with serving() as client:
        for kind in ("text/plain", "application/x-www-form-urlencoded", ""):
            headers = {"Content-Type": kind} if kind else {}
            answer = await client.patch(f"{STREAM}/settings?prepare=true", content=b'{"codec": "raw"}', headers=headers)
            assert answer.status_code == 415


@pytest.mark.parametrize(
    ("method", "headers", "status"),
    [
        ("PATCH", {"Origin": "http://127.0.0.1"}, 202),
        ("PATCH", {"Origin": "https://evil.example"}, 403),
        ("PATCH", {"Origin": "null"}, 403),
        ("PATCH", {"Origin": "http://["}, 403),
        ("GET", {"Host": "["}, 403),
        ("GET", {"Origin": "https://evil.example"}, 200),
        ("GET", {"Host": "evil.example"}, 403),
        ("GET", {"Host": "localhost:8080"}, 200),
        ("GET", {"Host": "[::1]:8080"}, 200),
    ],
)
async def test_a_page_of_another_origin_cannot_use_a_browser_of_this_machine(serving, method, headers, status):
    async with serving() as client:
        path = f"{STREAM}/settings?prepare=true" if method == "PATCH" else "/api/v1/streams"
        answer = await client.request(method, path, content=b'{"codec": "raw"}', headers=JSON | headers)
        assert answer.status_code == status
        assert "access-control-allow-origin" not in answer.headers


async def test_behind_a_proxy_any_host_is_answered_to_once_there_is_a_token(serving, config):
    store = Store(config.database_url)
    token = create_token(store, "ada", "operator")
    store.close()
    async with serving(token) as client:
        headers = JSON | {"Host": "fleet.example", "Origin": "https://fleet.example"}
        answer = await client.patch(f"{STREAM}/settings?prepare=true", content=b'{"codec": "raw"}', headers=headers)
        assert answer.status_code == 202


def test_what_somebody_outside_can_cause_does_not_fill_the_log(caplog):
    log = SparseLog(logging.getLogger("tests"), every_s=0.5)
    for _ in range(100):
        log.warning("a wrong token from %s", "x")
    assert len(caplog.records) == 1
    time.sleep(0.6)
    log.warning("a wrong token from %s", "x")
    assert "(99 earlier warnings were omitted)" in caplog.text


async def test_changes_come_too_often(serving):
    async with serving(changes_per_second=0.1, burst=2) as client:
        answers = [await client.patch(f"{STREAM}/settings?prepare=true", json={"codec": "raw"}) for _ in range(3)]
        assert [answer.status_code for answer in answers] == [202, 202, 429]
        assert int(answers[-1].headers["retry-after"]) >= 1
        assert (await client.get("/api/v1/streams")).status_code == 200


def test_threads_that_wait_for_vehicles_are_shared_out():
    shared = Limits()
    slots = [shared.slot("a", "a stream") for _ in range(limits.SLOTS_A_CLIENT)]
    for slot in slots:
        slot.__enter__()
    with pytest.raises(TooManyError), shared.slot("a", "a stream"):
        pass
    with shared.slot("b", "another"):
        pass
    slots[0].__exit__(None, None, None)
    with shared.slot("a", "a stream"):
        pass


def test_clients_are_forgotten_so_that_memory_is_bounded():
    shared = Limits()
    for number in range(limits.MAX_CLIENTS * 2):
        shared.change(f"client {number}")
    assert len(shared._left) == limits.MAX_CLIENTS


async def test_what_nobody_expected_tells_an_id_and_nothing_else(serving, caplog, monkeypatch):
    async with serving() as client:

        def broken():
            raise RuntimeError("the password is swordfish")

        monkeypatch.setattr(client.app.state.service, "streams", broken)
        answer = await client.get("/api/v1/streams")
    assert answer.status_code == 500
    assert answer.headers["content-type"] == "application/problem+json"
    assert "swordfish" not in answer.text
    assert "RuntimeError" not in answer.text
    assert answer.json()["instance"].removeprefix("urn:uuid:") in caplog.text
    assert "swordfish" in caplog.text


async def test_every_answer_tells_browsers_to_be_careful(serving):
    async with serving() as client:
        for path in ("/", "/docs", "/healthz", "/nothing"):
            headers = (await client.get(path)).headers
            assert headers["x-content-type-options"] == "nosniff"
        assert "script-src 'sha256-" in (await client.get("/docs")).headers["content-security-policy"]

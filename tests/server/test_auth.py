"""Who may do what: a fleet that anybody can change is nobody's fleet."""

from __future__ import annotations

import logging

import pytest
from starlette.requests import HTTPConnection

from lidarcodec.errors import SettingsError
from lidarcodec_server.auth import subprotocol_of
from lidarcodec_server.config import ServerConfig
from lidarcodec_server.serve import check_open
from lidarcodec_server.store.store import Store
from lidarcodec_server.tokens import create_token, digest_of
from tests.server.conftest import STREAM, until


@pytest.fixture
def store(config):
    found = Store(config.database_url)
    found.open()
    yield found
    found.close()


@pytest.mark.parametrize("path", ["/api/v1/streams", STREAM, f"{STREAM}/settings", f"{STREAM}/audit", "/api/v1/codecs"])
async def test_once_there_is_a_token_every_route_needs_one(serving, store, path):
    create_token(store, "ada", "viewer")
    async with serving() as client:
        for headers in ({}, {"Authorization": "Bearer lct_wrong"}, {"Authorization": "Basic YTpi"}):
            answer = await client.get(path, headers=headers)
            assert answer.status_code == 401
            assert answer.headers["www-authenticate"].startswith("Bearer")
            assert answer.headers["content-type"] == "application/problem+json"


@pytest.mark.parametrize("path", ["/metrics", "/openapi.json"])
async def test_metrics_and_the_document_need_a_token_too(serving, store, path):
    token = create_token(store, "ada", "viewer")
    async with serving() as client:
        assert (await client.get(path)).status_code == 401
        assert (await client.get(path, headers={"Authorization": f"Bearer {token}"})).status_code == 200


async def test_health_and_the_pages_that_ask_for_the_token_need_none(serving, store):
    create_token(store, "ada", "viewer")
    async with serving(metrics_open=True) as client:
        for path in ("/healthz", "/readyz", "/", "/docs", "/metrics"):
            assert (await client.get(path)).status_code == 200, path


async def test_a_viewer_looks_and_an_operator_changes_under_its_name(serving, store):
    viewer, operator = create_token(store, "vera", "viewer"), create_token(store, "otto", "operator")
    async with serving(viewer) as client:
        assert (await client.get("/api/v1/streams")).status_code == 200
        for method, path in (("PATCH", "settings"), ("DELETE", "settings"), ("POST", "keyframe")):
            answer = await client.request(method, f"{STREAM}/{path}", json={"codec": "zstd"})
            assert answer.status_code == 403, path
        headers = {"Authorization": f"Bearer {operator}"}
        assert (
            await client.patch(f"{STREAM}/settings?prepare=true", json={"codec": "zstd"}, headers=headers)
        ).status_code == 202
        (entry,) = (await client.get(f"{STREAM}/audit")).json()
        assert entry["who"] == "otto"


async def test_a_revoked_token_stops_working_and_revoking_the_last_opens_nothing(serving, store):
    token = create_token(store, "ada", "operator")
    async with serving(token) as client:
        assert (await client.get("/api/v1/streams")).status_code == 200
        assert store.revoke_token("ada")

        async def refused():
            return (await client.get("/api/v1/streams")).status_code == 401

        assert await until(refused)
    async with serving() as client:
        assert (await client.get("/api/v1/streams")).status_code == 401


async def test_a_token_made_while_the_server_runs_closes_it(serving, store):
    async with serving() as client:
        assert (await client.get("/api/v1/streams")).status_code == 200
        create_token(store, "ada", "viewer")

        async def closed():
            return (await client.get("/api/v1/streams")).status_code == 401

        assert await until(closed)


async def test_failed_logins_are_logged_and_counted_and_no_token_is_ever_in_the_log(serving, store, caplog):
    token = create_token(store, "ada", "viewer")
    caplog.set_level(logging.DEBUG)
    async with serving(token, metrics_open=True) as client:
        await client.get("/api/v1/streams", headers={"Authorization": "Bearer lct_guess"})
        await client.patch(f"{STREAM}/settings", json={"codec": "raw"})
        text = (await client.get("/metrics")).text
    assert 'lidarcodec_auth_failures_total{reason="wrong"} 1.0' in text
    assert 'lidarcodec_auth_failures_total{reason="role"} 1.0' in text
    assert "a wrong token from 127.0.0.1" in caplog.text
    assert "lct_guess" not in caplog.text
    assert token not in caplog.text


def test_only_a_digest_is_kept(store):
    token = create_token(store, "ada", "viewer")
    (kept,) = store.tokens()
    assert kept.digest == digest_of(token)
    assert token not in str(kept)
    assert len({create_token(store, f"n{number}", "viewer") for number in range(20)}) == 20


@pytest.mark.parametrize(("name", "role"), [("a b", "viewer"), ("", "viewer"), ("server", "viewer"), ("ada", "king")])
def test_a_token_needs_a_name_and_a_role(store, name, role):
    with pytest.raises(SettingsError):
        create_token(store, name, role)


def test_a_name_is_used_once_even_after_it_was_revoked(store):
    create_token(store, "ada", "viewer")
    store.revoke_token("ada")
    with pytest.raises(SettingsError, match="another name"):
        create_token(store, "ada", "viewer")


def test_without_tokens_only_this_machine_is_served_unless_told_so(config, store, caplog):
    check_open(config)
    outside = config.model_copy(update={"host": "0.0.0.0"})
    with pytest.raises(SettingsError, match="token create"):
        check_open(outside)
    check_open(outside.model_copy(update={"insecure": True}))
    create_token(store, "ada", "viewer")
    check_open(outside)
    assert "are sent unencrypted" in caplog.text


@pytest.mark.parametrize(
    ("host", "loopback"),
    [
        *[(host, True) for host in ("127.0.0.1", "127.5.5.5", "::1", "[::1]", "localhost")],
        *[(host, False) for host in ("0.0.0.0", "::", "10.0.0.1", "localhost.example", "")],
    ],
)
def test_which_hosts_are_this_machine(host, loopback):
    assert ServerConfig(host=host).loopback is loopback


@pytest.mark.parametrize(
    ("offered", "taken"),
    [(None, None), ("lidarcodec.token.x", "lidarcodec.token.x"), ("lidarcodec.token.x, cloud", "cloud")],
)
def test_the_subprotocol_to_accept_with_is_not_the_token_if_there_is_another(offered, taken):
    headers = [] if offered is None else [(b"sec-websocket-protocol", offered.encode())]
    assert subprotocol_of(HTTPConnection({"type": "websocket", "headers": headers})) == taken

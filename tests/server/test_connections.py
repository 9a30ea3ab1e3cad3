"""Who holds many connections keeps nobody else out: health checks, operators and other hosts still get in."""

from __future__ import annotations

import asyncio
import contextlib
import resource
import socket

import pytest

from lidarcodec.errors import SettingsError
from lidarcodec_server.config import ServerConfig
from lidarcodec_server.door.connections import Connections, host_of
from lidarcodec_server.fairness import Fair
from lidarcodec_server.serve import with_handles
from lidarcodec_server.store.store import Store
from lidarcodec_server.tokens import create_token
from tests.faults.serving import Server
from tests.server.conftest import STREAM
from tests.server.test_request_protocol import GET, connected
from tests.transport.conftest import free_port
from tests.transport.test_contract import eventually


class Ledger(Connections):
    """Remembers what was ended."""

    def __init__(self, *limits, **options):
        super().__init__(*limits, **options)
        self.closed = []

    def come(self, key, host="10.0.0.1"):
        return self.admit(key, host, lambda: self.closed.append(key))


def test_the_connection_of_a_host_that_waited_longest_gives_way_to_its_next_one():
    ledger = Ledger(10, 2)
    assert [ledger.come(key) for key in "abc"] == ["ordinary"] * 3
    assert ledger.closed == ["a"]
    ledger.works("b")
    ledger.come("d")
    assert ledger.closed == ["a", "c"]
    ledger.waits("b")
    ledger.come("e")
    assert ledger.closed == ["a", "c", "d"]
    assert len(ledger) == 2


def test_where_all_places_are_taken_the_host_that_has_most_gives_way():
    ledger = Ledger(5, 4)
    for key in "abcd":
        ledger.come(key)
    assert ledger.come("x", "10.0.0.2") == "ordinary"
    assert ledger.come("y", "10.0.0.3") == "ordinary"
    assert ledger.closed == ["a"]


def test_where_nobody_waits_only_the_reserved_places_are_left_and_then_none():
    ledger = Ledger(2, 2, 1)
    for key in "ab":
        ledger.come(key)
        ledger.works(key)
    assert ledger.come("c", "10.0.0.2") == "reserved"
    assert ledger.come("d", "10.0.0.3") == "reserved", "one that waits in a reserved place gives way"
    assert ledger.closed == ["c"]
    ledger.works("d")
    assert ledger.come("e", "10.0.0.4") == "refused"
    assert ledger.ended == {"gave way": 1, "refused": 1}
    for key in "abd":
        ledger.gone(key)
        ledger.gone(key)
    assert len(ledger) == 0
    assert ledger.come("f") == "ordinary"
    assert not ledger._waiting["10.0.0.1"].keys() - {"f"}


def test_a_proxy_has_no_limit_of_its_own():
    ledger = Ledger(100, 2, proxies=["10.0.0.1"])
    assert {ledger.come(key) for key in range(50)} == {"ordinary"}
    assert not ledger.closed


def test_an_address_counts_with_its_network():
    assert host_of("2001:db8:1:2:3::4") == host_of("2001:db8:1:2::1") != host_of("2001:db8:1:3::1")
    assert host_of("::1") == "::1"


def test_a_proxy_is_an_address():
    with pytest.raises(ValueError, match="not the address of a proxy"):
        ServerConfig(proxies=("proxy.example",))


async def test_a_client_that_does_not_read_is_ended(monkeypatch):
    held = Connections()
    body = b"x" * 2**24

    async def large(scope, receive, send):
        await send({"type": "http.response.start", "status": 200, "headers": []})
        await send({"type": "http.response.body", "body": body})

    monkeypatch.setattr("tests.server.test_request_protocol.app", large)
    async with connected(limit_s=5.0, held=held, read_s=0.3) as (_, writer, state):
        writer.transport.pause_reading()
        writer.write(GET)
        for _ in range(200):
            await asyncio.sleep(0.05)
            if held.ended["slow"] and not state.connections:
                break
        assert held.ended["slow"] == 1
        assert not len(held)


async def test_the_reserved_places_serve_health_checks_and_operators_and_close(serving, config):
    store = Store(config.database_url)
    tokens = {role: create_token(store, role, role) for role in ("viewer", "operator")}
    store.close()
    async with serving() as client:
        app = client.app
        statuses = {}
        for who, path in (
            ("", "/healthz"),
            ("", "/readyz"),
            ("", "/"),
            ("viewer", "/api/v1/streams"),
            ("operator", "/api/v1/streams"),
        ):
            headers = [(b"host", b"127.0.0.1")]
            if who:
                headers.append((b"authorization", f"Bearer {tokens[who]}".encode()))
            scope = {"type": "http", "method": "GET", "path": path, "raw_path": path.encode(), "query_string": b""}
            scope |= {"headers": headers, "client": ("10.0.0.9", 1), "server": None, "scheme": "http"}
            answers = []

            async def send(message, answers=answers):
                answers.append(message)

            async def receive():
                return {"type": "http.request", "body": b"", "more_body": False}

            await app(scope | {"state": {"reserved": True}}, receive, send)
            statuses[who, path] = answers[0]["status"]
            assert (b"connection", b"close") in [(name.lower(), value) for name, value in answers[0]["headers"]]
    assert list(statuses.values()) == [200, 200, 503, 503, 200]


async def test_requests_of_one_host_wait_for_one_another_and_health_checks_for_nobody():
    running, most, go = 0, 0, asyncio.Event()

    async def app(scope, receive, send):
        nonlocal running, most
        running += 1
        most = max(most, running)
        await go.wait()
        running -= 1

    fair = Fair(app, most=2, wait_s=0.2)

    def ask(host, path="/api"):
        scope = {"type": "http", "method": "GET", "path": path, "headers": [], "client": (host, 1)}
        return asyncio.create_task(fair(scope, None, send))

    answered = []

    async def send(message):
        answered.append(message.get("status"))

    tasks = [ask("10.0.0.1") for _ in range(5)]
    await asyncio.sleep(0.05)
    assert (running, most) == (2, 2)
    tasks += [ask("10.0.0.2"), ask("10.0.0.1", "/healthz")]
    await asyncio.sleep(0.5)
    assert running == 4
    assert [status for status in answered if status] == [429] * 3
    go.set()
    await asyncio.gather(*tasks)
    assert fair._turns == {}


def test_the_limit_of_open_files_is_raised_and_what_it_leaves_is_used(monkeypatch, caplog):
    asked = []
    monkeypatch.setattr(resource, "getrlimit", lambda _: (1024, 600))
    monkeypatch.setattr(resource, "setrlimit", lambda _, limits: asked.append(limits))
    config = ServerConfig(database_url="sqlite://", max_connections=1000)
    assert with_handles(config).max_connections == 600 - 256 - config.reserved_connections
    assert asked == [(600, 600)]
    assert "this process may open 600 files" in caplog.text


@pytest.mark.timeout(120)
def test_idle_connections_of_one_host_do_not_stop_health_checks(tmp_path):
    """A process of its own, with limits that a test can reach."""
    server = Server(
        tmp_path,
        free_port(),
        free_port(),
        LIDARCODEC_SERVE_MAX_CONNECTIONS="30",
        LIDARCODEC_SERVE_MAX_CONNECTIONS_A_HOST="20",
        LIDARCODEC_SERVE_RESERVED_CONNECTIONS="4",
    )
    with contextlib.ExitStack() as stack:
        stack.callback(server.kill)
        server.start()
        idle = [stack.enter_context(socket.create_connection(("127.0.0.1", server.port), 5)) for _ in range(100)]
        for half in idle[::2]:
            with contextlib.suppress(OSError):
                half.sendall(b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nX-A: ")
        assert [server.ask("/healthz")[0] for _ in range(20)] == [200] * 20
        # A body that does not come is a request that nobody gives way to.
        begun = f"POST {STREAM}/recording HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Type: application/json\r\n"

        def full() -> bool:
            for _ in range(5):
                one = stack.enter_context(socket.create_connection(("127.0.0.1", server.port), 5))
                one.sendall(f"{begun}Content-Length: 100\r\n\r\n{{".encode())
            return server.ask("/api/v1/streams")[0] in (429, 503)

        assert eventually(full)
        assert [server.ask("/healthz")[0] for _ in range(20)] == [200] * 20
        for one in idle:
            one.close()
        assert eventually(lambda: server.ask("/api/v1/streams")[0] == 200)
        assert "gave way" in server.ask_text("/metrics")


def test_a_proxy_that_is_none_is_wrong_usage():
    from lidarcodec.commands.server_extra import server_config

    with pytest.raises(SettingsError, match="not the address of a proxy"):
        server_config(proxies=("here",))

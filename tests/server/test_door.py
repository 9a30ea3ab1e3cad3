"""Who connects, asks or sends in small parts as fast as it can costs others nothing, with a token or without."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import socket
import ssl
import threading
import time
from functools import partial
from pathlib import Path

import httpx
import pytest
import uvicorn
from uvicorn.server import ServerState

from lidarcodec.commands.certs.certificates import Authority
from lidarcodec_server.door.acceptor import PATIENCE_S, WAITING, Acceptor
from lidarcodec_server.door.connections import Connections
from lidarcodec_server.door.door import HANDSHAKE_S, Door
from lidarcodec_server.door.request_protocol import CHUNKS, MAX_HEADERS, RequestProtocol, Times
from lidarcodec_server.store.store import Store
from lidarcodec_server.tokens import create_token
from tests.command_line import start
from tests.faults.serving import Server
from tests.server.conftest import STREAM, until
from tests.server.floods import flood, longest_answer_s, sending, upgrade, ws_frame
from tests.server.test_metrics import value
from tests.server.test_request_protocol import LIMIT_S, connected
from tests.transport.conftest import free_port
from tests.transport.test_contract import eventually

POST = b"POST / HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\n\r\n"
LONG_S = 1.5
"""Long for a health check on a busy machine; chunks of a byte took up to 38 s, with connections again and again 5 s."""


async def body_of(scope, receive, send):
    """Answers with the length of the body, or before it with /early."""
    size = 0
    while scope["path"] != "/early":
        message = await receive()
        if message["type"] == "http.disconnect":
            return
        size += len(message["body"])
        if not message["more_body"]:
            break
    await send({"type": "http.response.start", "status": 200, "headers": [(b"content-length", b"5")]})
    await send({"type": "http.response.body", "body": b"%5d" % size})


@pytest.mark.parametrize("path", [b"/", b"/early"])
async def test_a_body_in_chunks_of_a_byte_is_refused_after_some(monkeypatch, path, caplog):
    """44,000 of them come in one packet, and took a second to parse; nobody needs a token to send them."""
    monkeypatch.setattr("tests.server.test_request_protocol.app", body_of)
    async with connected(limit_s=5.0) as (reader, writer, state):
        writer.write(POST.replace(b"/ ", path + b" ") + 40_000 * b"1\r\nx\r\n")
        with contextlib.suppress(ConnectionError):
            answer = await asyncio.wait_for(reader.read(), LIMIT_S)
            assert b" 400 " in answer or (path == b"/early" and b" 200 " in answer)
        for _ in range(100):
            if not state.connections:
                break
            await asyncio.sleep(0.02)
        assert not state.connections
    assert "Traceback" not in caplog.text


@pytest.mark.parametrize("size", [1, 100, 4096])
async def test_a_body_in_chunks_of_an_ordinary_size_is_taken(monkeypatch, size):
    monkeypatch.setattr("tests.server.test_request_protocol.app", body_of)
    count = CHUNKS if size == 1 else 60_000 // size
    async with connected(limit_s=5.0) as (reader, writer, _):
        writer.write(POST + count * (b"%x\r\n" % size + b"x" * size + b"\r\n") + b"0\r\n\r\n")
        answer = await asyncio.wait_for(reader.readuntil(b"%5d" % (count * size)), LIMIT_S)
        assert b" 200 " in answer


async def test_a_request_with_very_many_headers_is_refused():
    async with connected(limit_s=5.0) as (reader, writer, _):
        writer.write(b"GET / HTTP/1.1\r\nHost: localhost\r\n" + MAX_HEADERS * b"X: y\r\n" + b"\r\n")
        answer = await asyncio.wait_for(reader.read(), LIMIT_S)
        assert answer.startswith(b"HTTP/1.1 431 ")
        assert b"16 KiB and 100 fields" in answer


@contextlib.asynccontextmanager
async def door(held, tokens=(), tls=None):
    """An application that answers everybody, behind an acceptor; the address to connect to."""

    async def app(scope, receive, send):
        await send({"type": "http.response.start", "status": 200, "headers": [(b"content-length", b"2")]})
        await send({"type": "http.response.body", "body": b"ok"})

    protocol = Door.of(RequestProtocol.of(held, Times(5.0, 5.0)), tls)
    config = uvicorn.Config(app, log_config=None, lifespan="off")
    config.load()
    state = ServerState()
    make = lambda: protocol(config=config, server_state=state, app_state={}, _loop=None)  # noqa: E731
    with socket.create_server(("127.0.0.1", 0)) as listener:
        owner = lambda token: token if token in tokens else None  # noqa: E731
        acceptor = Acceptor(listener, make, held, owner, encrypted=tls is not None)
        try:
            yield listener.getsockname()
        finally:
            acceptor.close()


async def ask(address, path="/", headers=""):
    """Status of a request on a connection of its own; 0 for one that is turned away without a word."""
    reader, writer = await asyncio.open_connection(*address)
    try:
        writer.write(f"GET {path} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n{headers}\r\n".encode())
        return int((await asyncio.wait_for(reader.read(), LIMIT_S) or b"- 0").split()[1])
    except ConnectionError:
        return 0
    finally:
        writer.close()


async def test_a_host_that_connects_too_often_is_turned_away_but_for_health_checks_and_tokens():
    held = Connections(a_second=3.0)
    async with door(held, tokens=("lct_good",)) as address:

        async def ask_often(times, headers=""):
            """How many get in, what the others are told, and how many more may get in meanwhile."""
            begin = time.monotonic()
            statuses = await asyncio.gather(*(ask(address, headers=headers) for _ in range(times)))
            return statuses.count(200), set(statuses) - {200}, 3.0 * (time.monotonic() - begin) + 1.0

        got_in, others, more = await ask_often(40)
        assert 6 <= got_in <= 6 + more
        assert 429 in others <= {429, 0}
        assert await ask(address, "/healthz") == 200
        assert await ask(address, "/readyz") == 200
        for headers in (
            "Authorization: Bearer lct_good\r\n",
            "Sec-WebSocket-Protocol: a, lidarcodec.token.lct_good\r\n",
        ):
            assert await ask(address, headers=headers) == 200
        got_in, _, more = await ask_often(40, "Authorization: Bearer lct_bad\r\n")
        assert got_in <= 6 + more, "some get in: a token may have been made a moment ago"
        _, others, _ = await ask_often(40, "Authorization: Bearer lct_good\r\n")
        assert others, "a token has a limit, too"

        async def may_again():
            await asyncio.sleep(0.5)
            return await ask(address) == 200

        assert await until(may_again), "it may again a little later"
    assert held.ended["hasty"] >= 5
    assert len(held) == 0


async def test_who_connects_too_often_and_says_nothing_or_little_is_turned_away_in_time():
    held = Connections(a_second=0.01)
    async with door(held, tokens=("lct_good",)) as address:
        await ask(address)
        began = time.monotonic()
        silent = [await asyncio.open_connection(*address) for _ in range(WAITING + 5)]
        slow_reader, slow_writer = await asyncio.open_connection(*address)
        slow_writer.write(b"GET / HTTP/1.1\r\nHost: localhost\r\nX: ")
        await asyncio.sleep(0.1)
        slow_writer.write(b"y\r\nAuthorization: Bearer lct_good\r\n\r\n")
        answer = await asyncio.wait_for(slow_reader.readuntil(b"\r\n"), LIMIT_S)
        assert b" 200 " in answer, "its token came a little later"
        for number, (reader, writer) in enumerate(silent):
            answer = await asyncio.wait_for(reader.read(), LIMIT_S)
            assert b" 429 " in answer or (number and not answer), "the first is told why"
            writer.close()
        slow_writer.close()
        assert PATIENCE_S <= time.monotonic() - began < PATIENCE_S + 50
    assert held.ended["hasty"] == WAITING + 5


async def test_half_a_handshake_uses_up_no_place_of_whole_ones(tmp_path):
    issued = Authority.open(tmp_path).issue("server", ("localhost",), 1)
    (tmp_path / "both.pem").write_bytes(issued.certificate + issued.key)
    tls = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    tls.load_cert_chain(tmp_path / "both.pem")
    trusting = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    trusting.check_hostname, trusting.verify_mode = False, ssl.CERT_NONE
    held = Connections(a_second=0.01)

    async def ask_encrypted(address):
        reader, writer = await asyncio.open_connection(*address, ssl=trusting)
        writer.write(b"GET / HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n")
        answer = await asyncio.wait_for(reader.readuntil(b"\r\n"), LIMIT_S)
        writer.close()
        return int(answer.split()[1])

    async with door(held, tls=tls) as address:
        assert await ask_encrypted(address) == 200, "within the rate"
        half = [await asyncio.open_connection(*address) for _ in range(20)]
        for _, writer in half:
            writer.write(b"\x16\x03\x01\x02\x00\x01")
        assert await ask_encrypted(address) == 200, "the first handshake beyond it"
        with pytest.raises(ConnectionError):
            await ask_encrypted(address)
        for reader, writer in half:
            with contextlib.suppress(ConnectionError):
                assert await asyncio.wait_for(reader.read(), LIMIT_S) == b""
            writer.close()
    assert held.ended["hasty"] == 21


async def test_requests_that_come_too_often_on_open_connections_wait():
    held = Connections(a_second=5.0)
    async with connected(limit_s=20.0, held=held) as (reader, writer, _):
        begin = time.monotonic()
        writer.write(30 * b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n")
        for _ in range(30):
            await asyncio.wait_for(reader.readuntil(b"ok"), LIMIT_S)
        assert 0.7 < time.monotonic() - begin < 60, "20 at once, then 10 a second"


def test_a_proxy_connects_as_often_as_it_likes():
    held = Connections(proxies=["10.0.0.1"], a_second=1.0)
    assert not any(held.hasty("10.0.0.1") for _ in range(100))
    assert held.pause_s("10.0.0.1") == 0.0
    assert [held.hasty("10.0.0.2") for _ in range(4)] == [False, False, False, True]


@pytest.mark.parametrize(
    ("who", "kind", "status"),
    [
        ("", "text/plain", 401),
        ("", "application/json", 401),
        ("viewer", "application/json", 403),
        ("viewer", "text/plain", 403),
        ("operator", "text/plain", 415),
    ],
)
async def test_a_body_that_never_comes_is_waited_for_only_where_it_is_wanted(serving, config, who, kind, status):
    """Otherwise anybody could hold all turns of a host."""
    store = Store(config.database_url)
    tokens = {role: create_token(store, role, role) for role in ("viewer", "operator")}
    store.close()

    async def body():
        yield b"{"
        await asyncio.sleep(200)

    async with serving(tokens.get(who), body_s=100.0) as client:
        for method, path in (("POST", "recording"), ("PATCH", "settings")):
            headers = {"Content-Type": kind}
            ask_it = client.request(method, f"{STREAM}/{path}", content=body(), headers=headers)
            answer = await asyncio.wait_for(ask_it, 60)
            assert answer.status_code == status
            assert answer.headers["content-type"] == "application/problem+json"


FLOODS = {
    "chunks": (POST.replace(b"/ ", f"{STREAM}/settings ".encode()), 20_000 * b"1\r\n \r\n"),
    "chunks that nobody reads": (POST.replace(b"POST / ", b"GET /healthz "), 20_000 * b"1\r\n \r\n"),
    "requests": (b"", 500 * b"GET /healthz HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n"),
}


@pytest.mark.timeout(180)
def test_floods_of_requests_do_not_stop_health_checks(tmp_path):
    server = Server(tmp_path, free_port(), free_port())
    with contextlib.ExitStack() as stack:
        stack.callback(server.kill)
        server.start()
        store = Store(f"sqlite:///{tmp_path / 'server.db'}")
        token = create_token(store, "ada", "operator")
        store.close()
        for name, (begin, blob) in FLOODS.items():
            with flood(4, partial(sending, port=server.port, begin=begin, blob=blob)):
                assert longest_answer_s(server.port, 0.5) < LONG_S, name
                headers = {"Authorization": f"Bearer {token}"}
                assert httpx.get(f"{server.url}/api/v1/streams", headers=headers, timeout=20).status_code == 200


def hurry(over: threading.Event, *, port: int, begin: bytes) -> None:
    """Connect again and again, and wait for no answer."""
    while not over.is_set():
        with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), 5) as one:
            one.sendall(begin)
        time.sleep(0.002)


@pytest.mark.sweep
@pytest.mark.timeout(180)
def test_who_connects_too_often_costs_little_and_health_checks_are_answered(tmp_path):
    """Each connection cost 4 ms of a processor, so the queue of those that wait was full; by processor time, because
    how long an answer takes is as much a matter of the machine.
    """
    server = Server(tmp_path, free_port(), free_port())
    with contextlib.ExitStack() as stack:
        stack.callback(server.kill)
        server.start()
        store = Store(f"sqlite:///{tmp_path / 'server.db'}")
        token = create_token(store, "ada", "operator")
        store.close()
        begin = upgrade("nobody/lidar/frames") + 1000 * ws_frame(2)
        with flood(4, partial(hurry, port=server.port, begin=begin)):
            time.sleep(2.0)
            first_s, first = cpu_s(server.process.pid), hasty(server, token)
            assert eventually(lambda: hasty(server, token) > first + 300, 90)
            each_s = (cpu_s(server.process.pid) - first_s) / (hasty(server, token) - first)
            assert server.ask("/healthz")[0] == 200
        assert each_s < 0.0025, each_s


def cpu_s(pid: int) -> float:
    """Processor time of a process until now."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def hasty(server: Server, token: str) -> float:
    """Connections that were turned away; who has a token is told even now, if not at the first attempt."""
    told = []

    def asked() -> bool:
        with contextlib.suppress(httpx.TransportError):
            told.append(httpx.get(f"{server.url}/metrics", headers={"Authorization": f"Bearer {token}"}, timeout=60))
        return bool(told)

    assert eventually(asked)
    return value(told[0].text, "lidarcodec_connections_ended_total", reason="hasty")


@pytest.mark.timeout(180)
def test_handshakes_that_do_not_end_count_as_connections_and_have_a_limit(tmp_path):
    """They counted once they were done, and had a minute: a host could have as many as there are file handles."""
    issued = Authority.open(tmp_path).issue("server", ("localhost",), 1)
    (tmp_path / "cert.pem").write_bytes(issued.certificate)
    (tmp_path / "key.pem").write_bytes(issued.key)
    options = ("--tls-certificate", tmp_path / "cert.pem", "--tls-key", tmp_path / "key.pem")
    options += ("--database-url", f"sqlite:///{tmp_path / 'server.db'}", "--listen", f"tcp/127.0.0.1:{free_port()}")
    with contextlib.ExitStack() as stack:
        server = stack.enter_context(start("serve", "--port", 0, "--max-connections-a-host", 20, *options))
        stack.callback(server.kill)
        url = server.stdout.readline().split()[2]
        # Each request on a connection of its own: one that waits for the next request gives way, as it should.
        once = {"headers": {"Connection": "close"}}
        client = stack.enter_context(httpx.Client(base_url=url, verify=False, timeout=20, **once))
        assert eventually(lambda: answers(client), 60)
        address, half = ("127.0.0.1", int(url.rpartition(":")[2])), []
        for _ in range(60):
            half.append(stack.enter_context(socket.create_connection(address, 5)))
            half[-1].sendall(b"\x16\x03\x01\x02\x00\x01")
        begin = time.monotonic()
        assert [client.get("/healthz").status_code for _ in range(5)] == [200] * 5
        counted = client.get("/metrics").text
        assert 10 <= value(counted, "lidarcodec_connections") <= 20
        assert value(counted, "lidarcodec_connections_ended_total", reason="gave way") >= 40
        half[-1].settimeout(HANDSHAKE_S + 20)
        with contextlib.suppress(ConnectionError):
            assert half[-1].recv(100) == b""
        assert time.monotonic() - begin < HANDSHAKE_S + 5
        asked = time.monotonic()
        server.send_signal(signal.SIGTERM)
        assert server.wait(60) == 0
        assert time.monotonic() - asked < 20


def answers(client) -> bool:
    try:
        return client.get("/readyz").status_code == 200
    except httpx.HTTPError:
        return False

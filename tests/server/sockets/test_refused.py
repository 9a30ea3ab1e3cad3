"""Who may look, and who is sent away: a client that reads nothing or sends rubbish would cost all others their view."""

from __future__ import annotations

import asyncio
import contextlib
import json
import socket as plain_socket
import time

import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus

from lidarcodec_server.live.session import CHECK_S
from lidarcodec_server.tokens import REFRESH_S, create_token
from tests.calm import Calm
from tests.server.live import frame, running
from tests.transport.test_contract import eventually

STREAM = "vehicle/lidar"


async def ending(socket) -> tuple[int, str]:
    """Code and reason with which the server closes the socket."""
    with contextlib.suppress(ConnectionClosed):
        while True:
            await asyncio.wait_for(socket.recv(), 60)
    return socket.close_code, socket.close_reason


async def test_what_a_client_does_not_read_is_not_kept_for_ever(server, vehicle, monkeypatch):
    monkeypatch.setattr(server.hub, "ack_limit_s", 0.5)
    monkeypatch.setattr("lidarcodec_server.live.protocol.ABORT_S", 0.5)
    monkeypatch.setattr("lidarcodec_server.live.session.CLOSE_LIMIT_S", 0.5)
    deaf = plain_socket.socket()
    deaf.setsockopt(plain_socket.SOL_SOCKET, plain_socket.SO_RCVBUF, 4096)
    with deaf:
        deaf.connect(("127.0.0.1", server.port))
        deaf.sendall(
            f"GET /api/v1/streams/{STREAM}/cloud?window=8 HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\n"
            "Connection: Upgrade\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n"
            "Sec-WebSocket-Version: 13\r\n\r\n".encode()
        )
        connections = server.server.server_state.connections
        assert await asyncio.to_thread(eventually, lambda: server.hub.state()["viewers"] == 1)
        assert await asyncio.to_thread(eventually, lambda: server.hub.state()["viewers"] == 0)
        assert await asyncio.to_thread(eventually, lambda: not connections)


async def test_who_never_acknowledges_is_sent_away_with_a_reason(server, vehicle, monkeypatch):
    monkeypatch.setattr(server.hub, "ack_limit_s", 1.0)
    async with server.socket(f"{STREAM}/cloud") as socket:
        code, reason = await ending(socket)
    assert code == 4408
    assert "acknowledgement" in reason


@pytest.mark.parametrize(
    ("sent", "code"),
    [("hello", 1008), (b"abc", 1008), ("9" * 21, 1008), ("1" * 1025, 1009), (b"x" * 5000, 1009), ("\u0663", 1008)],
)
async def test_a_viewer_that_sends_anything_else_is_sent_away(server, vehicle, sent, code):
    async with server.socket(f"{STREAM}/cloud?max_points=10") as socket:
        await frame(socket)
        await socket.send(sent)
        assert (await ending(socket))[0] == code


@pytest.mark.sweep
async def test_a_flood_of_acknowledgements_is_ended(server, vehicle):
    async with server.socket(f"{STREAM}/cloud?max_points=10") as socket:
        with contextlib.suppress(ConnectionClosed):
            for _ in range(10_000):
                await socket.send("999999999")
                await asyncio.sleep(0)
        assert (await ending(socket))[0] == 1008


async def test_viewers_that_vanish_leave_nothing_behind(server, vehicle):
    for _ in range(5):
        socket = await server.socket(f"{STREAM}/cloud?max_points=10")
        await frame(socket)
        socket.transport.abort()
    assert await asyncio.to_thread(eventually, lambda: server.hub.state()["viewers"] == 0)


@pytest.mark.parametrize(
    ("path", "status"),
    [
        ("nobody/lidar/cloud", 404),
        (f"{STREAM}/cloud?form=mesh", 422),
        (f"{STREAM}/cloud?colour=1", 422),
        (f"{STREAM}/frames?rate=1", 422),
    ],
)
async def test_what_cannot_be_is_refused_before_the_socket_opens(server, vehicle, path, status):
    with pytest.raises(InvalidStatus) as caught:
        async with server.socket(path):
            pass
    response = caught.value.response
    assert response.status_code == status
    assert json.loads(response.body)["status"] == status


async def test_more_viewers_than_allowed_are_refused_and_may_come_later(server, vehicle):
    sockets = [await server.socket(f"{STREAM}/cloud?max_points=10") for _ in range(12)]
    with pytest.raises(InvalidStatus) as caught:
        await server.socket(f"{STREAM}/cloud")
    assert caught.value.response.status_code == 503
    for socket in sockets:
        await socket.close()
    assert eventually(lambda: server.hub.state()["viewers"] == 0)
    async with server.socket(f"{STREAM}/cloud") as socket:
        await frame(socket)


async def test_one_client_cannot_take_the_places_of_all(server, vehicle, monkeypatch):
    monkeypatch.setattr(server.hub.seats, "most_a_client", 2)
    sockets = [await server.socket(f"{STREAM}/{kind}") for kind in ("cloud?max_points=10", "frames")]
    with pytest.raises(InvalidStatus) as caught:
        await server.socket(f"{STREAM}/cloud")
    assert caught.value.response.status_code == 429
    assert "127.0.0.1" in json.loads(caught.value.response.body)["detail"]
    for socket in sockets:
        await socket.close()
    assert eventually(lambda: not server.hub.seats.of("127.0.0.1"))
    async with server.socket(f"{STREAM}/cloud") as socket:
        await frame(socket)


async def test_viewers_leave_room_for_operators_and_for_one_another(tmp_path):
    """Two viewers took all sockets, on a stream that was away, and kept them."""
    with running(tmp_path, max_viewers=8, max_viewers_a_client=4, ack_limit_s=60.0) as server, server.publisher():
        assert server.seen()
        store = server.app.state.service.store
        tokens = {name: create_token(store, name, "viewer") for name in ("anna", "bert", "carl", "dora")}
        tokens["ada"] = create_token(store, "ada", "operator")
        assert await asyncio.to_thread(eventually, lambda: server.app.state.service.tokens.needed)

        def look(name):
            return server.socket(f"{STREAM}/frames", additional_headers={"Authorization": f"Bearer {tokens[name]}"})

        sockets = [await look(name) for name in ("anna", "anna", "anna", "bert", "bert", "bert", "bert")]
        async with look("ada") as socket:
            await frame(socket)
        async with look("carl") as socket:
            await frame(socket)
            assert (await ending(sockets[6]))[0] == 4429
            async with look("ada") as other, look("dora") as one:
                await frame(other)
                await frame(one)
        statuses = []
        for _ in range(5):
            try:
                sockets.append(await look("anna"))
            except InvalidStatus as error:
                statuses.append(error.response.status_code)
        assert statuses
        assert set(statuses) <= {429, 503}
        await asyncio.gather(*(one.close() for one in sockets))


async def test_a_page_of_another_site_may_not_look(server, vehicle):
    with pytest.raises(InvalidStatus) as caught:
        await server.socket(f"{STREAM}/cloud", origin="http://elsewhere.example")
    assert caught.value.response.status_code == 403
    async with server.socket(f"{STREAM}/cloud", origin=server.url) as socket:
        await frame(socket)


async def test_the_subprotocol_that_carries_a_token_is_answered(server, vehicle):
    async with server.socket(f"{STREAM}/cloud", subprotocols=["lidarcodec", "lidarcodec.token.abc"]) as socket:
        assert socket.subprotocol == "lidarcodec", "a token would stand in the answer"


async def test_a_token_that_is_revoked_ends_its_sockets_within_a_second(tmp_path):
    assert CHECK_S + REFRESH_S <= 0.8, "the rest of the second is for a busy machine"
    with running(tmp_path) as server, server.publisher():
        assert server.seen()
        store = server.app.state.service.store
        async with server.socket(f"{STREAM}/cloud?max_points=10") as nobody:
            token = create_token(store, "screen", "viewer")
            assert (await ending(nobody))[0] == 4401, "from the first token on everybody needs one"
        with pytest.raises(InvalidStatus) as caught:
            await server.socket(f"{STREAM}/cloud")
        assert caught.value.response.status_code == 401
        protocols = ["lidarcodec", f"lidarcodec.token.{token}"]
        async with server.socket(f"{STREAM}/cloud?max_points=10", subprotocols=protocols) as socket:
            await frame(socket)
            with Calm() as calm:
                store.revoke_token("screen")
                begin = time.monotonic()
                assert (await ending(socket))[0] == 4401
                took_s = time.monotonic() - begin
            assert took_s < 3.0 + 20 * calm.late_s

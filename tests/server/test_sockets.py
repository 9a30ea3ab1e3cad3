"""The live sockets over real HTTP: newest only, a slow viewer costs nobody else, nobody who looks leaves a trace."""

from __future__ import annotations

import asyncio
import contextlib
import json
import socket as plain_socket
import struct
import threading
import time

import httpx
import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus

from lidarcodec.pipeline import StreamDecoder
from lidarcodec.settings import StreamSettings
from lidarcodec.wire import peek, unpack
from lidarcodec_server.tokens import create_token
from tests.calm import Calm
from tests.server.live import client_module, event, frame, running
from tests.transport.test_contract import eventually

CLIENT = client_module()
STREAM = "vehicle/lidar"


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    with running(tmp_path_factory.mktemp("server"), max_viewers=12, ack_limit_s=60.0) as one:
        one.hub.linger_s = 0.1
        yield one


@pytest.fixture
def vehicle(server):
    """A vehicle at 20 Hz whose stream the server knows; afterwards nobody watches it."""
    with server.publisher() as one:
        assert server.seen()
        yield one
    assert eventually(lambda: not server.hub.watches())


def index_of(message: bytes) -> int:
    return CLIENT.read_message(message)[0]["frame_index"]


def decoders() -> list[str]:
    return [one.name for one in threading.enumerate() if one.name == "lidarcodec decode"]


async def ending(socket) -> tuple[int, str]:
    """Code and reason with which the server closes the socket."""
    with contextlib.suppress(ConnectionClosed):
        while True:
            await asyncio.wait_for(socket.recv(), 20)
    return socket.close_code, socket.close_reason


async def test_a_viewer_sees_the_points_of_the_vehicle(server, vehicle):
    async with server.socket(f"{STREAM}/cloud") as socket:
        hello = json.loads(await socket.recv())
        assert (hello["event"], hello["format"], hello["vehicle"]) == ("hello", 1, "vehicle")
        assert hello["options"]["attributes"] == ["intensity", "ring"]
        sensor = await event(socket, "sensor")
        head, arrays = CLIENT.read_message(await frame(socket))
        assert head["count"] > 100_000
        assert (sensor["rings"], len(sensor["laser"])) == (64, 64)
        assert head["stream_id"] == vehicle.stream_id
        assert 0 <= head["latency_ms"] < 60_000
        distance = np.linalg.norm(CLIENT.points_of(head, arrays), axis=1)
        assert 0.5 < distance.min() < distance.max() < 30


async def test_the_next_frame_comes_only_after_an_acknowledgement_and_is_the_newest(server, vehicle):
    async with server.socket(f"{STREAM}/cloud?form=range") as socket:
        first = index_of(await frame(socket))
        with pytest.raises(TimeoutError):
            await asyncio.wait_for(frame(socket), 1.0)
        assert await asyncio.to_thread(eventually, lambda: vehicle.next_index > first + 15, 60)
        await socket.send(str(first))
        second = index_of(await frame(socket))
        assert second >= first + 10, "not the frame behind the first one, but the newest"
        await socket.send(struct.pack("<Q", second))
        assert index_of(await frame(socket)) > second


async def test_ten_viewers_one_decoder_and_the_slow_one_costs_the_others_nothing(server, vehicle):
    watched: dict[int, list[int]] = {}

    async def look(number: int, seconds: float) -> None:
        seen = watched[number] = []
        async with server.socket(f"{STREAM}/cloud?max_points=5000") as socket:
            end = time.monotonic() + seconds
            while time.monotonic() < end:
                seen.append(index_of(await frame(socket)))
                await asyncio.sleep(1.0 if number == 0 else 0.0)
                await socket.send("ack")

    async def look_on() -> None:
        await asyncio.sleep(1.5)
        assert len(decoders()) == 1

    with Calm() as calm:
        await asyncio.gather(look_on(), *(look(number, 3.5) for number in range(10)))
    slow, fast = watched.pop(0), list(watched.values())
    span = max(max(seen) for seen in fast) - min(min(seen) for seen in fast) + 1
    for seen in fast:
        assert seen == sorted(set(seen))
        assert len(seen) > 0.5 * len(set().union(*fast))
        assert len(seen) > 2 * len(slow)
        assert len(seen) > 0.5 * span or calm.late_s > 0.1
    assert len(slow) <= 5
    assert np.diff(slow).min() > 5, "the slow one gets the newest, not the next"


async def test_without_viewers_there_is_no_receiver_and_no_decoder(server, vehicle):
    assert not server.hub.watches()
    assert not decoders()
    async with server.socket(f"{STREAM}/cloud") as socket:
        await frame(socket)
        assert len(decoders()) == 1
    assert eventually(lambda: not server.hub.watches() and not decoders())
    assert eventually(lambda: not vehicle.status()["matching"]), "the vehicle stops sending when nobody looks"


async def test_the_frames_socket_sends_what_the_vehicle_sent_and_decodes_nothing(server, vehicle):
    decoder, got = StreamDecoder(), []
    async with server.socket(f"{STREAM}/frames") as socket:
        while len(got) < 10:
            got += decoder.decode(unpack(await frame(socket)))
            await socket.send("ack")
        (watch,) = server.hub.watches().values()
        assert not watch.receiver.decoding
        assert watch.receiver.stats.decode_ms.summary()["count"] == 0
    assert peek(await_key := await _first(server)).key
    assert StreamDecoder().decode(unpack(await_key))


async def _first(server) -> bytes:
    async with server.socket(f"{STREAM}/frames") as socket:
        return await frame(socket)


async def test_a_slow_viewer_of_a_chain_of_messages_gets_only_what_it_can_decode(server):
    settings = StreamSettings(codec_settings={"mask_history": True}, key_interval=100_000)
    with server.publisher(settings=settings):
        assert server.seen()
        async with server.socket(f"{STREAM}/frames") as slow, server.socket(f"{STREAM}/frames") as quick:
            decoder, indices, kept = StreamDecoder(), [], []

            async def keep_up() -> None:
                async for message in quick:
                    if isinstance(message, bytes):
                        kept.append(peek(message).frame_index)
                        await quick.send("ack")

            other = asyncio.create_task(keep_up())
            for _ in range(3):
                message = unpack(await frame(slow))
                indices += [one.index for one in decoder.decode(message)]
                before = len(kept)
                async with asyncio.timeout(60):
                    while len(kept) < before + 6:
                        await asyncio.sleep(0.01)
                await slow.send("ack")
            assert indices == sorted(set(indices))
            assert indices[-1] - indices[0] > 6, "it skips"
            await quick.close()
            await other
    assert eventually(lambda: not server.hub.watches())


async def test_viewers_are_told_of_a_restart_of_settings_and_of_silence(server):
    async with asyncio.timeout(60):
        with server.publisher() as car:
            assert server.seen()
            socket = await server.socket(f"{STREAM}/cloud?form=range")
            try:
                await frame(socket)
                await socket.send("ack")
                car.change(codec="zstd")
                while (await event(socket, "settings"))["settings"]["codec"] != "zstd":
                    pass
                car.stop()
                await event(socket, "gone")
                assert (await event(socket, "stale"))["silent_s"] >= 2.0
                with server.publisher() as again:
                    told: dict[str, dict] = {}
                    while not {"alive", "restarted"} <= set(told):
                        message = await socket.recv()
                        if isinstance(message, str):
                            told[json.loads(message)["event"]] = json.loads(message)
                        else:
                            assert CLIENT.read_message(message)[0]["stream_id"] == again.stream_id
                            await socket.send("ack")
                    assert int(told["restarted"]["stream_id"], 16) == again.stream_id
            finally:
                await socket.close()


async def test_viewers_are_told_that_the_source_has_ended(server):
    with server.publisher(40):
        assert server.seen()
        async with server.socket(f"{STREAM}/cloud?max_points=10") as socket:
            await event(socket, "ended", 60)


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


async def test_frames_that_come_in_groups_are_shown_one_by_one(server):
    with server.publisher(settings=StreamSettings(codec="jpeg-layered"), rate=10.0) as car:
        assert server.seen()
        async with server.socket(f"{STREAM}/cloud?form=range") as socket:
            indices = []
            while len(indices) < 16:
                indices.append(index_of(await frame(socket)))
                await socket.send("ack")
        assert indices == sorted(set(indices))
        assert np.count_nonzero(np.diff(indices) == 1) + car.status()["replaced"] >= 7, "not one of each group"


async def test_a_rate_is_kept(server, vehicle):
    async with server.socket(f"{STREAM}/cloud?form=range&rate=5") as socket:
        await frame(socket)
        await socket.send("ack")
        begin = time.monotonic()
        for _ in range(5):
            await frame(socket)
            await socket.send("ack")
        assert 0.8 < time.monotonic() - begin < 20


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
    monkeypatch.setattr(server.hub, "max_viewers_a_client", 2)
    sockets = [await server.socket(f"{STREAM}/{kind}") for kind in ("cloud?max_points=10", "frames")]
    with pytest.raises(InvalidStatus) as caught:
        await server.socket(f"{STREAM}/cloud")
    assert caught.value.response.status_code == 429
    assert "127.0.0.1" in json.loads(caught.value.response.body)["detail"]
    assert server.hub.room_for("another")
    for socket in sockets:
        await socket.close()
    assert eventually(lambda: server.hub.room_for("127.0.0.1"))
    async with server.socket(f"{STREAM}/cloud") as socket:
        await frame(socket)


async def test_a_page_of_another_site_may_not_look(server, vehicle):
    with pytest.raises(InvalidStatus) as caught:
        await server.socket(f"{STREAM}/cloud", origin="http://elsewhere.example")
    assert caught.value.response.status_code == 403
    async with server.socket(f"{STREAM}/cloud", origin=server.url) as socket:
        await frame(socket)


async def test_the_subprotocol_that_carries_a_token_is_answered(server, vehicle):
    async with server.socket(f"{STREAM}/cloud", subprotocols=["lidarcodec", "lidarcodec.token.abc"]) as socket:
        assert socket.subprotocol == "lidarcodec", "a token would stand in the answer"


def test_a_snapshot_is_a_picture_and_is_made_once_for_a_frame(server, vehicle):
    with httpx.Client(base_url=f"{server.url}/api/v1/streams", timeout=30) as client:
        for view in ("cloud", "range"):
            answer = client.get(f"{STREAM}/snapshot.png", params={"view": view})
            assert answer.status_code == 200
            assert answer.headers["content-type"] == "image/png"
            assert answer.content.startswith(b"\x89PNG")
        assert client.get(f"{STREAM}/snapshot.png", params={"view": "map"}).status_code == 422
        assert client.get("nobody/lidar/snapshot.png").status_code == 404


def test_a_snapshot_of_a_vehicle_that_is_away_says_so(server):
    with server.publisher(vehicle="gone"):
        assert server.seen("gone/lidar")
    assert eventually(lambda: not server.app.state.service.stream(_keys("gone")).alive)
    answer = httpx.get(f"{server.url}/api/v1/streams/gone/lidar/snapshot.png", timeout=30)
    assert answer.status_code == 503
    assert answer.headers["content-type"] == "application/problem+json"


def _keys(vehicle: str):
    from lidarcodec.transport.keys import StreamKeys

    return StreamKeys(vehicle, "lidar")


async def test_a_receiver_that_fails_is_replaced_and_the_viewers_stay(server, vehicle):
    async with server.socket(f"{STREAM}/cloud?form=range") as socket:
        await frame(socket)
        (watch,) = server.hub.watches().values()
        broken = watch.receiver

        def fail(data: bytes) -> None:
            raise RuntimeError("a fault in the receiver's thread")

        watch.tap(fail)
        assert await asyncio.to_thread(eventually, lambda: broken.failure is not None)
        watch.untap(fail)
        assert await asyncio.to_thread(eventually, lambda: watch.receiver is not broken)
        for _ in range(3):
            await socket.send("ack")
            await frame(socket)
        assert server.hub.counts["receivers failed"] == 1


async def test_prometheus_is_told_of_viewers(server, vehicle):
    async with httpx.AsyncClient(base_url=server.url, timeout=30) as client:
        async with server.socket(f"{STREAM}/cloud") as socket:
            await frame(socket)
            text = (await client.get("/metrics")).text
            assert 'lidarcodec_viewers{kind="cloud",sensor="lidar",vehicle="vehicle"} 1.0' in text
        text = (await client.get("/metrics")).text
        (sent,) = [line for line in text.splitlines() if line.startswith('lidarcodec_viewer_sent_total{kind="cloud"}')]
        assert float(sent.rpartition(" ")[2]) >= 1.0
        assert "lidarcodec_viewer_pack_p99_seconds" in text
        assert "lidarcodec_recordings_running 0.0" in text


async def test_a_token_that_is_revoked_ends_its_sockets(tmp_path, monkeypatch):
    monkeypatch.setattr("lidarcodec_server.live.session.CHECK_S", 0.2)
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
            store.revoke_token("screen")
            assert (await ending(socket))[0] == 4401

"""The live sockets over real HTTP: newest only, a slow viewer costs nobody else, nobody who looks leaves a trace."""

from __future__ import annotations

import asyncio
import json
import struct
import threading
import time

import httpx
import numpy as np
import pytest

from lidarcodec.pipeline import StreamDecoder
from lidarcodec.settings import StreamSettings
from lidarcodec.transport.base import Priority
from lidarcodec.transport.keys import StreamKeys
from lidarcodec.wire import peek, unpack
from tests import asking
from tests.server.live import client_module, event, frame
from tests.transport.test_contract import eventually

CLIENT = client_module()
STREAM = "vehicle/lidar"


def index_of(message: bytes) -> int:
    return CLIENT.read_message(message)[0]["frame_index"]


def decoders() -> list[str]:
    return [one.name for one in threading.enumerate() if one.name == "lidarcodec decode"]


async def test_a_viewer_sees_the_points_of_the_vehicle(server, vehicle):
    async with server.socket(f"{STREAM}/cloud") as socket:
        hello = json.loads(await socket.recv())
        assert (hello["event"], hello["format"], hello["vehicle"]) == ("hello", 1, "vehicle")
        assert (hello["options"]["attributes"], hello["options"]["fill"]) == (["intensity", "ring", "filled"], True)
        sensor = await event(socket, "sensor")
        head, arrays = CLIENT.read_message(await frame(socket))
        assert head["count"] > 15_000
        assert (sensor["rings"], len(sensor["laser"])) == (64, 64)
        assert head["stream_id"] == vehicle.stream_id
        assert 0 <= head["latency_ms"] < 60_000
        distance = np.linalg.norm(CLIENT.points_of(head, arrays), axis=1)
        assert 0.5 < distance.min() < distance.max() < 30


async def test_gaps_are_filled_in_for_a_person_and_not_where_a_program_is_to_look(server, vehicle):
    made_up = 128
    async with server.socket(f"{STREAM}/cloud?attributes=filled") as socket:

        async def seen(purpose, flag):
            vehicle.change(codec="pcodec", target_kbps=150, purpose=purpose)
            for _ in range(200):
                head, _ = CLIENT.read_message(await frame(socket))
                await socket.send("ack")
                rate = vehicle.status()["rate"]
                if bool(head["flags"] & made_up) == flag and rate["step"] > 1:
                    return True
            return False

        assert await seen("look", True)
        assert await seen("detect", False)


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


@pytest.mark.sweep
async def test_ten_viewers_one_decoder_and_the_slow_one_costs_the_others_nothing(server, vehicle):
    fast, slow = [[] for _ in range(9)], []
    over = asyncio.Event()

    async def look(seen: list[int]) -> None:
        async with server.socket(f"{STREAM}/cloud?max_points=5000") as socket:
            while not over.is_set():
                seen.append(index_of(await frame(socket)))
                await socket.send("ack")

    async def look_slowly() -> None:
        """Each of the others sees ten frames while this one has not said that it has one."""
        async with server.socket(f"{STREAM}/cloud?max_points=5000") as socket:
            for _ in range(3):
                slow.append(index_of(await frame(socket)))
                before = [len(seen) for seen in fast]
                async with asyncio.timeout(60):
                    while any(len(seen) < count + 10 for seen, count in zip(fast, before, strict=True)):
                        await asyncio.sleep(0.01)
                assert len(decoders()) == 1
                await socket.send("ack")

    async def until_over() -> None:
        try:
            await look_slowly()
        finally:
            over.set()

    await asyncio.gather(until_over(), *map(look, fast))
    for seen in fast:
        assert seen == sorted(set(seen))
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


@pytest.mark.parametrize("kind", ["cloud?max_points=10", "frames"])
async def test_a_path_that_sends_the_past_once_more_shows_it_to_no_viewer(server, kind):
    """The viewer opens behind the messages that come again, so nobody can know them as duplicates."""
    transport, keys = server.network.transport(), StreamKeys("vehicle", "lidar")
    inbox, again = transport.inbox(keys.frame), transport.sender(keys.frame, Priority.FRAMES)
    with server.publisher(settings=StreamSettings(codec="raw")):
        assert server.seen()
        past = [inbox.receive() for _ in range(5)]
        async with server.socket(f"{STREAM}/{kind}") as socket:
            indices = []
            for number in range(15):
                data = await frame(socket)
                indices.append(index_of(data) if kind != "frames" else peek(data).frame_index)
                if number % 3 == 2:
                    again.put(past[number // 3])
                await socket.send("ack")
            (watch,) = server.hub.watches().values()
            assert indices == sorted(indices)
            assert eventually(lambda: watch.receiver.stats.counts["stale"] > 0)
    inbox.close()


async def _first(server) -> bytes:
    async with server.socket(f"{STREAM}/frames") as socket:
        return await frame(socket)


@pytest.mark.sweep
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


@pytest.mark.sweep
async def test_viewers_are_told_that_the_source_has_ended(server):
    with server.publisher(40):
        assert server.seen()
        async with server.socket(f"{STREAM}/cloud?max_points=10") as socket:
            await event(socket, "ended", 60)


async def test_frames_that_come_in_groups_are_shown_one_by_one(server):
    with server.publisher(settings=StreamSettings(codec="jpeg-layered"), rate=10.0) as car:
        assert server.seen()
        async with server.socket(f"{STREAM}/cloud?form=range") as socket:
            indices = []
            while len(indices) < 16:
                message = await frame(socket)
                if CLIENT.read_message(message)[0]["stream_id"] == car.stream_id:  # not the last one of a stream before
                    indices.append(index_of(message))
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
    answer = asking.get(f"{server.url}/api/v1/streams/gone/lidar/snapshot.png", timeout=30)
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

"""Recordings on the server: started, limited, stopped, listed after a restart, played; no bad disk hurts others."""

from __future__ import annotations

import json
import os
import shutil
import time
from concurrent.futures import ThreadPoolExecutor

import httpx
import pytest
from websockets.sync.client import connect

import lidarcodec
from lidarcodec.apps.receiver.live_stream import subscribe
from lidarcodec.assembly import packets_of
from lidarcodec.recording import RotatingRecorder
from lidarcodec_server.live.shelf import MissingRecordingError, Shelf
from tests.apps.streams import Loop
from tests.server.live import frame, running
from tests.sweeps import spread
from tests.transport.test_contract import eventually

STREAM = "/api/v1/streams/vehicle/lidar"
ALL = "/api/v1/recordings"


@pytest.fixture
def server(tmp_path):
    with running(tmp_path) as one:
        one.hub.linger_s = 0.2
        yield one


@pytest.fixture
def client(server):
    with httpx.Client(base_url=server.url, timeout=30) as one:
        yield one


def frames_of(client, at_least):
    return eventually(lambda: (client.get(f"{STREAM}/recording").json().get("frames") or 0) >= at_least)


def recorded(client, server, frames=5, **body):
    """A recording of that many frames or more."""
    with server.publisher():
        assert server.seen()
        assert client.post(f"{STREAM}/recording", json=body or None).status_code == 201
        assert frames_of(client, frames)
        answer = client.delete(f"{STREAM}/recording")
        assert answer.status_code == 200
        return answer.json()


def test_a_recording_holds_what_the_vehicle_sent_and_can_be_played_without_the_server(server, client, tmp_path):
    made = recorded(client, server)
    assert (made["state"], made["vehicle"], made["sensor"], made["reason"]) == ("complete", "vehicle", "lidar", None)
    assert made["size_bytes"] > 100_000
    (listed,) = client.get(ALL).json()
    assert listed == made
    (file,) = (tmp_path / "recordings" / made["id"]).glob("*.mcap")
    with lidarcodec.open_source(file) as source:
        payloads = {packet.payload[:1200] for packet in source.packets()}
    assert len(list(lidarcodec.read_frames(file))) == made["frames"]
    assert payloads <= {packet.payload[:1200] for packet in Loop(1).packets()}


def test_recordings_are_there_after_a_restart_and_one_that_was_cut_off_says_so(tmp_path):
    with running(tmp_path) as server, httpx.Client(base_url=server.url, timeout=30) as client:
        made = recorded(client, server)
    folder = tmp_path / "recordings"
    cut = folder / "20260101T000000Z-abcdef"
    shutil.copytree(folder / made["id"], cut)
    about = json.loads((cut / "about.json").read_text()) | {"state": "recording", "ended_ns": None}
    (cut / "about.json").write_text(json.dumps(about))
    for name in ("notes", "20260101T000000Z-000000"):
        (folder / name).mkdir()
    (folder / "20260101T000000Z-000000" / "about.json").write_text('{"vehicle": 1e999')
    with running(tmp_path) as server, httpx.Client(base_url=server.url, timeout=30) as client:
        states = {one["id"]: one["state"] for one in client.get(ALL).json()}
        assert states == {made["id"]: "complete", cut.name: "interrupted"}
        assert client.delete(f"{ALL}/{cut.name}").status_code == 204
        assert [one["id"] for one in client.get(ALL).json()] == [made["id"]]


async def test_a_recording_needs_no_viewer_and_no_decoder(server, client):
    with server.publisher():
        assert server.seen()
        assert client.post(f"{STREAM}/recording").status_code == 201
        assert frames_of(client, 3)
        (watch,) = server.hub.watches().values()
        assert not watch.receiver.decoding
        async with server.socket("vehicle/lidar/cloud") as socket:
            await frame(socket)
        assert eventually(lambda: not watch.receiver.decoding)
        assert client.get(f"{STREAM}/recording").json()["state"] == "recording"
        assert client.post(f"{STREAM}/recording").status_code == 409
        assert client.delete(f"{ALL}/{client.get(ALL).json()[0]['id']}").status_code == 409
        assert client.delete(f"{STREAM}/recording").json()["frames"] > 0
        assert client.delete(f"{STREAM}/recording").status_code == 404
        assert eventually(lambda: not server.hub.watches())


@pytest.mark.parametrize(("limit", "told"), [({"max_bytes": 300_000}, "bytes"), ({"max_seconds": 0.5}, "s was")])
def test_a_recording_ends_at_its_limit_and_says_which(server, client, limit, told):
    with server.publisher():
        assert server.seen()
        name = client.post(f"{STREAM}/recording", json=limit).json()["id"]
        assert eventually(lambda: client.get(f"{ALL}/{name}").json()["state"] == "complete")
        assert told in client.get(f"{ALL}/{name}").json()["reason"]


async def test_a_disk_that_fails_costs_the_recording_and_nothing_else(server, client, tmp_path):
    with server.publisher():
        assert server.seen()
        name = client.post(f"{STREAM}/recording").json()["id"]
        active = next(iter(server.app.state.recordings._active.values()))
        async with server.socket("vehicle/lidar/cloud?max_points=10") as socket:
            await frame(socket)
            active.recorder._files._stop("No space left on device")  # as when a write raises ENOSPC
            assert eventually(lambda: client.get(f"{ALL}/{name}").json()["state"] == "failed")
            assert "space" in client.get(f"{ALL}/{name}").json()["reason"]
            assert 'lidarcodec_recordings_ended_total{reason="failed"} 1.0' in client.get("/metrics").text
            await socket.send("ack")
            await frame(socket)


@pytest.mark.parametrize(("what", "stopped"), spread(["folder", "file", "replaced"], [False, True]))
def test_a_recording_whose_file_somebody_removed_is_not_said_to_be_complete(
    server, client, tmp_path, monkeypatch, stopped, what
):
    """Another server may have the same folder: what the disk takes of a file without a name is lost."""
    if stopped:
        monkeypatch.setattr("lidarcodec_server.live.recordings.LOOK_S", 600.0)
    with server.publisher():
        assert server.seen()
        name = client.post(f"{STREAM}/recording").json()["id"]
        assert frames_of(client, 5)
        folder = tmp_path / "recordings" / name
        if what == "folder":
            shutil.rmtree(folder)
        elif what == "file":
            next(folder.glob("*.mcap")).unlink()
        else:
            (tmp_path / "other").write_text("other")
            (tmp_path / "other").replace(next(folder.glob("*.mcap")))
        if stopped:
            assert client.delete(f"{STREAM}/recording").json()["state"] == "failed"
        assert eventually(lambda: client.get(f"{ALL}/{name}").json()["state"] == "failed")
        assert "removed" in client.get(f"{ALL}/{name}").json()["reason"]
        assert client.delete(f"{ALL}/{name}").status_code == 204
        assert client.get(f"{ALL}/{name}").status_code == 404


def test_a_recording_that_a_slow_disk_made_full_of_holes_says_so_and_is_not_done_before_it_is(
    server, client, monkeypatch
):
    monkeypatch.setattr("lidarcodec.apps.recorder.CLOSE_LIMIT_S", 0.5)
    written = RotatingRecorder.write

    def slowly(self, data):
        time.sleep(0.4)
        written(self, data)

    monkeypatch.setattr(RotatingRecorder, "write", slowly)
    with server.publisher(rate=30.0):
        assert server.seen()
        client.post(f"{STREAM}/recording")
        active = next(iter(server.app.state.recordings._active.values()))
        assert eventually(lambda: active.recorder.state()["counts"].get("dropped", 0) > 5)
        ended = client.delete(f"{STREAM}/recording").json()
        assert not active.recorder.writing
    assert (ended["state"], "the disk was too slow" in ended["reason"]) == ("failed", True)
    assert client.get(f"{ALL}/{ended['id']}").json() == ended


def test_a_folder_without_room_is_refused_before_anything_is_written(tmp_path):
    with running(tmp_path) as server, httpx.Client(base_url=server.url, timeout=30) as client, server.publisher():
        assert server.seen()
        server.app.state.recordings.shelf.min_free_bytes = 2**62
        answer = client.post(f"{STREAM}/recording")
        assert answer.status_code == 507
        assert "free" in answer.json()["detail"]
        assert client.get(ALL).json() == []


def test_a_folder_that_cannot_be_made_is_a_problem(tmp_path):
    (tmp_path / "file").write_text("")
    with (
        running(tmp_path, recordings=tmp_path / "file" / "recordings") as server,
        httpx.Client(base_url=server.url, timeout=30) as client,
        server.publisher(),
    ):
        assert server.seen()
        answer = client.post(f"{STREAM}/recording")
        assert (answer.status_code, answer.headers["content-type"]) == (507, "application/problem+json")
        assert str(tmp_path) not in answer.text + client.get(ALL).text  # where it is concerns no client


def test_a_recording_is_played_as_a_stream_of_its_own(server, client):
    made = recorded(client, server, 8)
    answer = client.post(f"{ALL}/{made['id']}/play", json={"vehicle": "again", "rate": 50, "loop": True})
    assert answer.status_code == 201, answer.text
    assert client.post(f"{ALL}/{made['id']}/play").status_code == 409
    assert client.delete(f"{ALL}/{made['id']}").status_code == 409
    assert server.seen("again/lidar")
    with subscribe("again/lidar", transport=server.network.transport()) as live:
        payload = packets_of(live.next(60))[0].payload
    assert payload[:1200] in {packet.payload[:1200] for packet in Loop(1).packets()}
    assert client.get(f"{ALL}/{made['id']}").json()["playing"]["vehicle"] == "again"
    assert client.get("/api/v1/streams/again/lidar/snapshot.png").status_code == 200
    address = f"ws://127.0.0.1:{server.port}/api/v1/streams/again/lidar/cloud"
    with connect(address, compression=None, max_size=None) as socket:
        assert json.loads(socket.recv(30))["options"]["fill"] is False, "a recording shows what was measured"
    assert client.delete(f"{ALL}/{made['id']}/play").status_code == 204
    assert client.delete(f"{ALL}/{made['id']}/play").status_code == 404
    assert client.get(f"{ALL}/{made['id']}").json()["playing"] is None


def test_who_recorded_played_and_deleted_is_in_the_audit_log(server, client):
    made = recorded(client, server, 2)
    play = f"{ALL}/{made['id']}/play"
    assert client.post(play, json={"vehicle": "again", "loop": True}).status_code == 201
    assert client.delete(play).status_code == 204
    assert client.delete(f"{ALL}/{made['id']}").status_code == 204
    for path, actions in (
        (STREAM, ["record-delete", "record-stop", "record"]),
        ("/api/v1/streams/again/lidar", ["play-stop", "play"]),
    ):
        entries = client.get(f"{path}/audit").json()
        assert [entry["action"] for entry in entries] == actions
        for entry in entries:
            assert (entry["who"], entry["changes"]) == ("127.0.0.1", {"recording": made["id"]})
            assert entry["result"] == "done"


def test_a_playback_ends_with_its_recording_and_takes_no_name_that_is_in_use(server, client):
    made = recorded(client, server, 3)
    with server.publisher():
        assert server.seen()
        answer = client.post(f"{ALL}/{made['id']}/play", json={"vehicle": "vehicle", "sensor": "lidar"})
        assert answer.status_code == 409
    answer = client.post(f"{ALL}/{made['id']}/play", json={"rate": 100})
    assert answer.json()["vehicle"] == f"playback-{made['id']}"
    assert eventually(lambda: client.get(f"{ALL}/{made['id']}").json()["playing"] is None)


def test_a_playback_that_cannot_be_is_refused(server, client):
    made = recorded(client, server, 1)
    for body in (
        {"vehicle": "a/b"},
        {"rate": 0},
        {"settings": {"codec": "mp3"}},
        {"settings": {"colour": 1}},
        {"to": 1},
    ):
        assert client.post(f"{ALL}/{made['id']}/play", json=body).status_code == 422, body
    assert client.get(f"{ALL}/{made['id']}").json()["playing"] is None


def test_no_id_leads_out_of_the_folder(server, client, tmp_path):
    shelf = Shelf(tmp_path / "recordings")
    for name in ("..", "%2e%2e", "..%2f..%2fetc", "notes", "20260101T000000Z-ABCDEF", "x" * 60):
        with pytest.raises(MissingRecordingError):
            shelf.path(name)
        for method, path in (("GET", ""), ("DELETE", ""), ("POST", "/play"), ("DELETE", "/play")):
            assert client.request(method, f"{ALL}/{name}{path}").status_code in (404, 405, 307), name


def test_recording_a_stream_that_was_never_seen_is_a_404(client):
    assert client.post("/api/v1/streams/nobody/lidar/recording").status_code == 404
    assert client.get("/api/v1/streams/nobody/lidar/recording").status_code == 404


@pytest.mark.sweep
def test_of_two_recordings_that_are_played_under_one_name_at_once_one_begins(server, client):
    """Both began, and the frames of both came as one stream."""
    ids = [recorded(client, server, 3)["id"] for _ in range(2)]
    body = {"vehicle": "again", "sensor": "lidar", "loop": True}
    for _ in range(3):
        with ThreadPoolExecutor(2) as pool:
            answers = list(pool.map(lambda one: client.post(f"{ALL}/{one}/play", json=body), ids))
        assert sorted(answer.status_code for answer in answers) == [201, 409]
        refused = next(answer.json()["detail"] for answer in answers if answer.status_code == 409)
        assert "again/lidar" in refused
        for one, answer in zip(ids, answers, strict=True):
            if answer.status_code == 201:
                assert client.delete(f"{ALL}/{one}/play").status_code == 204
        assert eventually(lambda: not client.get("/api/v1/streams/again/lidar").json().get("alive"))


@pytest.mark.parametrize("kind", ["about.json", "drive.mcap"])
def test_a_pipe_in_the_folder_of_recordings_holds_up_nobody(server, client, tmp_path, kind):
    """Opening one waits until somebody writes to it: the list of recordings never came."""
    made = recorded(client, server, 1)
    folder = tmp_path / "recordings" / "20261121T101500Z-3fa2c9"
    folder.mkdir()
    if kind != "about.json":
        shutil.copy(tmp_path / "recordings" / made["id"] / "about.json", folder)
    os.mkfifo(folder / kind)
    listed = [one["id"] for one in client.get(ALL, timeout=10).json()]
    assert listed == [made["id"]] if kind == "about.json" else made["id"] in listed
    answer = client.post(f"{ALL}/{folder.name}/play", timeout=10)
    assert answer.status_code == 404
    assert client.get(ALL, timeout=10).status_code == 200


@pytest.mark.parametrize("damage", [lambda file: file.write_bytes(b"nothing"), lambda file: os.truncate(file, 600)])
def test_a_recording_that_cannot_be_played_is_named_by_its_id_alone(server, client, tmp_path, damage):
    made = recorded(client, server, 1)
    (file,) = (tmp_path / "recordings" / made["id"]).glob("*.mcap")
    damage(file)
    answer = client.post(f"{ALL}/{made['id']}/play")
    assert answer.status_code == 422
    assert made["id"] in answer.json()["detail"]
    assert "/" not in answer.json()["detail"]

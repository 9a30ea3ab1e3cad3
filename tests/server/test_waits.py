"""Every wait has a limit: what stands still costs its own request, and says so."""

from __future__ import annotations

import threading
import time

import httpx
import pytest

from lidarcodec.apps.receiver.receiver import Receiver
from tests.server.live import running
from tests.transport.test_contract import eventually

STREAM = "/api/v1/streams/vehicle/lidar"


@pytest.fixture
def server(tmp_path):
    with running(tmp_path) as one:
        yield one


@pytest.fixture
def client(server):
    with httpx.Client(base_url=server.url, timeout=90) as one:
        yield one


def test_a_disk_that_stands_still_holds_up_the_end_of_a_recording_no_longer_than_allowed(server, client, monkeypatch):
    monkeypatch.setattr("lidarcodec_server.live.recordings.END_S", 0.3)
    go = threading.Event()
    with server.publisher():
        assert server.seen()
        assert client.post(f"{STREAM}/recording").status_code == 201
        recorder = next(iter(server.app.state.recordings._active.values())).recorder
        close = recorder.close
        monkeypatch.setattr(recorder, "close", lambda: (go.wait(60), close()))
        begin = time.monotonic()
        answer = client.delete(f"{STREAM}/recording")
        assert time.monotonic() - begin < 30.0
        assert answer.status_code == 507
        assert "the disk does not respond" in answer.json()["detail"]
        go.set()
        assert eventually(lambda: client.get(f"{STREAM}/recording").status_code == 404), "it ends all the same"


def test_a_stream_that_cannot_be_opened_in_time_holds_nobody_up_and_is_opened_later(server, client, monkeypatch):
    monkeypatch.setattr("lidarcodec_server.live.hub.OPEN_S", 0.3)
    go, start = threading.Event(), Receiver.start
    monkeypatch.setattr(Receiver, "start", lambda self: (go.wait(60), start(self)))
    with server.publisher():
        assert server.seen()
        answer = client.get(f"{STREAM}/snapshot.png")
        assert answer.status_code == 503
        assert "could not be opened" in answer.json()["detail"]
        go.set()
        monkeypatch.setattr("lidarcodec_server.live.hub.OPEN_S", 60.0)
        assert client.get(f"{STREAM}/snapshot.png").status_code == 200

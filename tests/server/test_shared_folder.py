"""Two servers with one folder of recordings: neither deletes, plays or calls interrupted what the other one uses."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import httpx
import pytest

from lidarcodec.transport.keys import StreamKeys
from lidarcodec_server.live.shelf import BusyRecordingError, Shelf
from tests.server.live import Running, running
from tests.server.test_recordings import ALL, STREAM, frames_of, recorded
from tests.transport.test_contract import eventually

RECORDS = """
import sys, time
from pathlib import Path
from lidarcodec.transport.keys import StreamKeys
from lidarcodec_server.live.shelf import Shelf
shelf = Shelf(Path(sys.argv[1]))
print(shelf.create(StreamKeys("vehicle", "lidar"), time.time_ns(), None).id, flush=True)
time.sleep(600)
"""


@pytest.fixture
def servers(tmp_path) -> Iterator[tuple[tuple[Running, httpx.Client], tuple[Running, httpx.Client]]]:
    """Two servers on one network with one folder of recordings, and a client of each."""
    (tmp_path / "second").mkdir()
    shelf = tmp_path / "recordings"
    with (
        running(tmp_path, recordings=shelf) as first,
        running(tmp_path / "second", first.network.transport(), recordings=shelf) as second,
        httpx.Client(base_url=first.url, timeout=30) as one,
        httpx.Client(base_url=second.url, timeout=30) as other,
    ):
        yield (first, one), (second, other)


def test_what_another_server_records_runs_and_can_be_neither_deleted_nor_played(servers, tmp_path):
    """It was `interrupted` there; deleting it ended the recording of the first as `failed`."""
    (first, one), (_, other) = servers
    with first.publisher():
        assert first.seen()
        name = one.post(f"{STREAM}/recording").json()["id"]
        assert frames_of(one, 3)
        (listed,) = other.get(ALL).json()
        assert (listed["id"], listed["state"], listed["ended"]) == (name, "recording", None)
        assert "another server" in listed["reason"]
        for answer in (other.delete(f"{ALL}/{name}"), other.post(f"{ALL}/{name}/play")):
            assert answer.status_code == 409, answer.text
            assert "another server" in answer.json()["detail"]
            assert str(tmp_path) not in answer.text
        assert one.get(f"{STREAM}/recording").json()["reason"] is None
        made = one.delete(f"{STREAM}/recording").json()
    assert (made["state"], made["reason"]) == ("complete", None)
    assert other.get(f"{ALL}/{name}").json() == made
    assert other.delete(f"{ALL}/{name}").status_code == 204


@pytest.mark.sweep
def test_what_another_server_plays_can_be_played_and_not_deleted(servers):
    (first, one), (_, other) = servers
    made = recorded(one, first, 3)
    path = f"{ALL}/{made['id']}"
    for client, vehicle in ((one, "again"), (other, "too")):
        assert client.post(f"{path}/play", json={"vehicle": vehicle, "loop": True}).status_code == 201
    assert one.delete(f"{path}/play").status_code == 204
    answer = one.delete(path)
    assert answer.status_code == 409
    assert "another server" in answer.json()["detail"]
    assert other.get(path).json()["playing"]["vehicle"] == "too"
    assert other.delete(f"{path}/play").status_code == 204
    assert one.delete(path).status_code == 204


def test_a_recording_whose_server_was_killed_is_interrupted_and_can_be_deleted(tmp_path):
    shelf = Shelf(tmp_path)
    with subprocess.Popen([sys.executable, "-c", RECORDS, str(tmp_path)], stdout=subprocess.PIPE, text=True) as other:
        try:
            assert other.stdout is not None
            name = other.stdout.readline().strip()
            assert shelf.recording(name).state == "recording"
            with pytest.raises(BusyRecordingError, match="another server"):
                shelf.remove(name)
        finally:
            other.kill()
    assert eventually(lambda: shelf.recording(name).state == "interrupted")
    shelf.remove(name)
    assert shelf.recordings() == []


def test_a_server_that_lists_recordings_holds_up_nobody_who_deletes(tmp_path):
    """To see whether somebody records is to try the lock: for that moment it is taken."""
    shelf, other = Shelf(tmp_path), Shelf(tmp_path)
    name = shelf.create(StreamKeys("vehicle", "lidar"), 0, None).id
    shelf.release(name)
    looking = other.hold(name)
    with ThreadPoolExecutor(1) as pool:
        done = pool.submit(shelf.remove, name)
        time.sleep(0.1)
        assert not done.done()
        looking.close()
        done.result(10)
    assert shelf.recordings() == []

"""Recordings fetched over REST: whole, in ranges, after a cut; bounded in number; never half without a word."""

from __future__ import annotations

import shutil
import socket
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack

import httpx
import pytest

import lidarcodec
from lidarcodec_server.live.download import MOST_A_CLIENT
from tests.server.live import running
from tests.server.test_recordings import ALL, STREAM, frames_of, recorded
from tests.transport.test_contract import eventually


@pytest.fixture(scope="module")
def there(tmp_path_factory):
    """A server with one recording; its client, what the recording is, and its file."""
    folder = tmp_path_factory.mktemp("downloads")
    with running(folder) as server, httpx.Client(base_url=server.url, timeout=30) as client:
        made = recorded(client, server)
        (file,) = (folder / "recordings" / made["id"]).glob("*.mcap")
        yield server, client, made, file


def test_a_download_is_the_recording_byte_for_byte_and_opens_here(there, tmp_path):
    _, client, made, file = there
    answer = client.get(f"{ALL}/{made['id']}/download")
    assert answer.status_code == 200
    assert answer.content == file.read_bytes()
    assert int(answer.headers["content-length"]) == made["size_bytes"]
    name = f"vehicle_lidar_{made['id']}.mcap"
    assert answer.headers["content-disposition"] == f'attachment; filename="{name}"'
    (tmp_path / name).write_bytes(answer.content)
    assert len(list(lidarcodec.read_frames(tmp_path / name))) == made["frames"]


def test_a_download_that_was_cut_goes_on_where_it_was(there):
    _, client, made, file = there
    whole, path = file.read_bytes(), f"{ALL}/{made['id']}/download"
    first = client.get(path, headers={"Range": "bytes=0-999"})
    assert (first.status_code, first.content) == (206, whole[:1000])
    rest = client.get(path, headers={"Range": "bytes=1000-", "If-Range": first.headers["etag"]})
    assert first.content + rest.content == whole
    assert rest.headers["content-range"] == f"bytes 1000-{len(whole) - 1}/{len(whole)}"
    other = client.get(path, headers={"Range": "bytes=1000-", "If-Range": '"another"'})
    assert (other.status_code, other.content) == (200, whole), "the file is another one: all of it"
    beyond = client.get(path, headers={"Range": f"bytes={len(whole)}-"})
    assert beyond.status_code == 416
    assert beyond.headers["content-type"] == "application/problem+json"


@pytest.mark.parametrize("name", ["20260101T000000Z-abcdef", "..%2f..%2fetc%2fpasswd", "x"])
def test_what_is_not_there_is_reported(there, name):
    _, client, _, _ = there
    answer = client.get(f"{ALL}/{name}/download")
    assert answer.status_code == 404
    assert answer.headers["content-type"] == "application/problem+json"


def test_a_recording_that_runs_is_not_given_by_halves(there):
    server, client, _, _ = there
    with server.publisher():
        assert server.seen()
        running_id = client.post(f"{STREAM}/recording").json()["id"]
        assert frames_of(client, 2)
        answer = client.get(f"{ALL}/{running_id}/download")
        assert answer.status_code == 409
        assert "stop it first" in answer.json()["detail"]
        client.delete(f"{STREAM}/recording")
    assert client.get(f"{ALL}/{running_id}/download").status_code == 200


def test_what_an_interrupted_recording_has_can_be_fetched(there):
    _, client, _, file = there
    cut = file.parent.parent / "20260102T000000Z-abcdef"
    shutil.copytree(file.parent, cut)
    about = (cut / "about.json").read_text().replace('"complete"', '"recording"')
    (cut / "about.json").write_text(about)
    whole = file.read_bytes()
    (cut / file.name).write_bytes(whole[: len(whole) // 2])
    assert client.get(f"{ALL}/{cut.name}/download").content == whole[: len(whole) // 2]
    assert client.delete(f"{ALL}/{cut.name}").status_code == 204


def begun(server, path):
    """A download whose client has read the first bytes of the answer, and no more."""
    one = socket.socket()
    one.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    one.settimeout(30)
    one.connect(("127.0.0.1", int(server.url.rpartition(":")[2])))
    one.sendall(f"GET {path} HTTP/1.1\r\nHost: localhost\r\n\r\n".encode())
    assert one.recv(12) == b"HTTP/1.1 200"
    return one


def test_who_goes_in_the_middle_keeps_no_place_and_no_recording(there):
    """Somebody else can download then, and the recording can be deleted."""
    server, client, _, file = there
    big = file.parent.parent / "20260103T000000Z-abcdef"
    shutil.copytree(file.parent, big)
    (big / file.name).write_bytes(bytes(64 << 20))
    path, some = f"{ALL}/{big.name}/download", {"Range": "bytes=0-9"}
    with ExitStack() as idle:
        for _ in range(MOST_A_CLIENT):
            idle.enter_context(begun(server, path))
        assert client.get(path, headers=some).status_code == 429
        assert client.delete(f"{ALL}/{big.name}").status_code == 409, "somebody still reads it"
    assert eventually(lambda: client.get(path, headers=some).status_code == 206)
    assert eventually(lambda: client.delete(f"{ALL}/{big.name}").status_code == 204)


def test_many_downloads_at_once_do_not_stop_health_checks(there):
    _, client, made, file = there
    whole, path = file.read_bytes(), f"{ALL}/{made['id']}/download"
    with ThreadPoolExecutor(12) as pool:
        answers = list(pool.map(lambda _: client.get(path), range(24)))
        start = time.monotonic()
        assert client.get("/healthz").status_code == 200
        assert time.monotonic() - start < 20
    kinds = {answer.status_code for answer in answers}
    assert kinds <= {200, 429}
    assert all(answer.content == whole for answer in answers if answer.status_code == 200)

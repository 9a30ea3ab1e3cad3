"""`lidarcodec serve` and a vehicle as processes, over Zenoh: what an operator runs."""

from __future__ import annotations

import json
import signal
import socket
import subprocess
import sys
import time

import httpx
import pytest
from websockets.sync.client import connect

from lidarcodec.pipeline import StreamDecoder
from lidarcodec.wire import unpack
from tests import asking, forks
from tests.command_line import COMMAND, environment
from tests.conftest import ROOT
from tests.drives import simulated
from tests.transport.conftest import free_port
from tests.transport.test_contract import eventually

STREAM = "/api/v1/streams/car-7/roof"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("server")


@pytest.fixture(scope="module")
def system(folder):
    """A server and a vehicle that meet on a loopback port of their own; the server, and its URL."""
    variables = environment(LIDARCODEC_LOOPBACK_PORT=str(free_port()))
    port = free_port()
    serve = ["serve", "--port", str(port), "--database-url", f"sqlite:///{folder / 'server.db'}"]
    drive = simulated("sim:city?frames=12", folder / "drive.pcap")
    publish = ["publish", str(drive), "--loop", "--vehicle", "car-7", "--sensor", "roof", "--rate", "4"]
    started = [
        forks.Process([*COMMAND, *words], env=variables, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        for words in ([*serve, "--recordings", str(folder / "recordings")], publish)
    ]
    url = f"http://127.0.0.1:{port}"

    def alive() -> bool:
        try:
            return asking.get(url + STREAM, timeout=60).json().get("alive", False)
        except httpx.HTTPError:
            return False

    try:
        assert eventually(alive, 60)
        yield started[0], url
    finally:
        for one in reversed(started):
            one.terminate()
            one.communicate(timeout=60)


@pytest.mark.parametrize("form", ["points", "range"])
def test_the_example_client_shows_the_points_without_lidarcodec(system, form):
    _, url = system
    words = ["car-7/roof", "--server", url, "--form", form, "--seconds", "0.5"]
    program = [sys.executable, str(ROOT / "clients" / "python" / "live_cloud.py"), *words]
    said = subprocess.run(program, capture_output=True, text=True, check=True, timeout=60).stdout
    assert "event: hello" in said
    assert "nearest above the road:" in said


def test_a_recording_is_played_over_the_network_of_the_server(system):
    _, url = system
    with httpx.Client(base_url=url, timeout=30) as client:
        name = client.post(f"{STREAM}/recording").json()["id"]
        assert eventually(lambda: (client.get(f"{STREAM}/recording").json()["frames"] or 0) >= 5, 60)
        client.delete(f"{STREAM}/recording").raise_for_status()
        play = client.post(f"/api/v1/recordings/{name}/play", json={"vehicle": "again", "loop": True})
        assert play.status_code == 201, play.text
        assert eventually(lambda: client.get("/api/v1/streams/again/roof").json().get("alive", False))
        picture = client.get("/api/v1/streams/again/roof/snapshot.png?view=range")
        assert picture.status_code == 200, picture.text
        client.delete(f"/api/v1/recordings/{name}/play").raise_for_status()


def test_sigterm_with_open_sockets_and_a_recording_ends_the_server_soon_and_keeps_the_recording(system, folder):
    server, url = system
    address = url.replace("http", "ws") + STREAM
    recording = asking.post(f"{url}{STREAM}/recording", timeout=30).json()["id"]
    with (
        connect(f"{address}/cloud", compression=None, max_size=None) as cloud,
        connect(f"{address}/frames", compression=None, max_size=None) as frames,
    ):
        decoder, decoded = StreamDecoder(), 0
        for message in frames:
            if isinstance(message, bytes):
                decoded += len(decoder.decode(unpack(message)))
                frames.send("ack")
            if decoded >= 3:
                break
        while isinstance(cloud.recv(30), str):
            pass
        deaf = socket.create_connection(("127.0.0.1", int(url.rpartition(":")[2])))
        deaf.sendall(
            f"GET {STREAM}/cloud HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n".encode()
        )
        time.sleep(1.0)
        begin = time.monotonic()
        server.send_signal(signal.SIGTERM)
        assert server.wait(60) == 0
        assert time.monotonic() - begin < 20  # 2 to 3 s on an idle machine
        deaf.close()
    about = json.loads((folder / "recordings" / recording / "about.json").read_text())
    assert about["state"] == "complete"
    assert about["frames"] >= 3

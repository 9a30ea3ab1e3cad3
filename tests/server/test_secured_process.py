"""The server as an operator behind a router with certificates: it needs every right that it has, and no more."""

from __future__ import annotations

import urllib.request

import pytest

from lidarcodec.commands.certs import command as certs
from tests.command_line import start
from tests.faults.serving import Server
from tests.transport.conftest import free_port
from tests.transport.router import Router
from tests.transport.test_contract import eventually

STREAM = "/api/v1/streams/car-7/lidar"


def alive(server: Server, stream: str) -> bool:
    code, found = server.ask(stream)
    return code == 200 and found["alive"]


@pytest.mark.timeout(120)
def test_a_server_behind_a_secured_router_lists_changes_shows_and_plays(tmp_path):
    port, config = free_port(), tmp_path / "fleet"
    certs.run(config, routers=["localhost"], vehicles=["car-7"], operators=["server"], port=port, days=30)
    router = Router(config=str(config / "router-localhost.json5"), listen=f"tls/localhost:{port}")
    zenoh = str(config / "operator-server.json5")
    own = {"LIDARCODEC_ZENOH_CONFIG": zenoh, "LIDARCODEC_SERVE_RECORDINGS": str(tmp_path)}
    server = Server(tmp_path, free_port(), free_port(), **own)
    car = start("publish", "sim:road?sensor=vlp16", "--rate", "4", "--zenoh-config", config / "vehicle-car-7.json5")
    try:
        server.start()
        assert eventually(lambda: alive(server, STREAM), 40)
        assert server.ask(f"{STREAM}/settings", "PATCH", {"codec": "zstd"})[0] == 200
        with urllib.request.urlopen(f"{server.url}{STREAM}/snapshot.png", timeout=40) as picture:
            assert picture.read(8) == b"\x89PNG\r\n\x1a\n"
        recording = server.ask(f"{STREAM}/recording", "POST", {"max_seconds": 2})[1]["id"]
        assert eventually(lambda: server.ask(f"/api/v1/recordings/{recording}")[1]["state"] == "complete", 40)
        code, played = server.ask(f"/api/v1/recordings/{recording}/play", "POST", {"loop": True})
        assert code < 300, played
        stream = f"/api/v1/streams/{played['vehicle']}/{played['sensor']}"
        assert eventually(lambda: alive(server, stream), 40)
    finally:
        car.terminate()
        car.communicate(timeout=60)
        server.kill()
        router.kill()

"""A real HTTP server in a thread, on a network in memory, for tests of the live side."""

from __future__ import annotations

import contextlib
import importlib.util
import json
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import uvicorn
from fastapi import FastAPI
from websockets.asyncio.client import ClientConnection, connect

from lidarcodec.apps.publisher.publisher import Publisher
from lidarcodec.settings import StreamSettings
from lidarcodec.transport import Transport
from lidarcodec.transport.memory import MemoryNetwork
from lidarcodec_server.app import create_app
from lidarcodec_server.config import ServerConfig
from lidarcodec_server.live.protocol import ViewerProtocol
from tests.apps.streams import Loop
from tests.conftest import ROOT
from tests.transport.test_contract import eventually


def client_module() -> ModuleType:
    """The example client that reads the socket by its description."""
    spec = importlib.util.spec_from_file_location("live_cloud", ROOT / "clients" / "python" / "live_cloud.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


class Running:
    """A server that runs, and the network that its vehicles are on."""

    def __init__(self, app: FastAPI, server: uvicorn.Server, network: MemoryNetwork | None) -> None:
        self.app, self.server, self.network = app, server, network
        self.port = server.servers[0].sockets[0].getsockname()[1]
        self.url = f"http://127.0.0.1:{self.port}"

    @property
    def hub(self) -> Any:
        return self.app.state.hub

    def publisher(self, frames: int | None = None, settings: StreamSettings | None = None, **options: Any) -> Publisher:
        """A vehicle on the network."""
        options = {"rate": 20.0} | options
        return Publisher(Loop(frames), settings, transport=self.network.transport(), **options)

    def socket(self, path: str, **options: Any) -> connect:
        """A viewer's socket: `vehicle/lidar/cloud?form=range`."""
        options = {"compression": None, "max_size": None} | options
        return connect(f"ws://127.0.0.1:{self.port}/api/v1/streams/{path}", **options)

    def seen(self, name: str = "vehicle/lidar") -> bool:
        """Wait until the server knows a stream."""
        vehicle, _, sensor = name.partition("/")

        def there() -> bool:
            known = [one for one in self.app.state.service.streams() if one.alive]
            return any((one.keys.vehicle, one.keys.sensor) == (vehicle, sensor) for one in known)

        return eventually(there)


@contextlib.contextmanager
def running(folder: Path, transport: Transport | None = None, **options: Any) -> Iterator[Running]:
    """A server with its files in a folder; on a network in memory unless a transport is given."""
    network = MemoryNetwork() if transport is None else None
    config = ServerConfig(
        **{"port": 0, "database_url": f"sqlite:///{folder / 'server.db'}", "recordings": folder / "recordings"}
        | options
    )
    app = create_app(config, transport=transport or network.transport())
    server = uvicorn.Server(
        uvicorn.Config(
            app,
            port=0,
            ws=ViewerProtocol,
            ws_per_message_deflate=False,
            log_level="error",
            timeout_graceful_shutdown=2,
        )
    )
    thread = threading.Thread(target=server.run, name="uvicorn")
    thread.start()
    try:
        assert eventually(lambda: server.started or not thread.is_alive())
        yield Running(app, server, network)
    finally:
        server.should_exit = True
        thread.join(20.0)
        assert not thread.is_alive()


async def event(socket: ClientConnection, name: str, limit_s: float = 20.0) -> dict[str, Any]:
    """The next event of that name; frames on the way to it are acknowledged."""
    end = time.monotonic() + limit_s
    while time.monotonic() < end:
        message = await socket.recv()
        if isinstance(message, bytes):
            await socket.send("ack")
        elif json.loads(message)["event"] == name:
            return json.loads(message)
    raise AssertionError(f"no event {name}")


async def frame(socket: ClientConnection) -> bytes:
    """The next frame, not acknowledged; events on the way are left out."""
    while isinstance(message := await socket.recv(), str):
        pass
    return message

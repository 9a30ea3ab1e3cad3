"""The server over its ASGI interface, and vehicles for it, on a network inside the test."""

from __future__ import annotations

import asyncio
import shutil
from collections.abc import Callable
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from typing import Any

import httpx
import pytest

from lidarcodec.apps.publisher.publisher import Publisher
from lidarcodec.settings import StreamSettings
from lidarcodec.transport.memory import MemoryNetwork
from lidarcodec_server.app import create_app
from lidarcodec_server.config import ServerConfig
from lidarcodec_server.store.store import Store
from tests.apps.streams import Loop

STREAM = "/api/v1/streams/car-7/roof"


async def until(condition, limit_s=60.0):
    """The first true value that an async function gives; generous, because the machine may be busy."""
    for _ in range(int(limit_s / 0.05)):
        if value := await condition():
            return value
        await asyncio.sleep(0.05)
    raise AssertionError("it never happened")


@pytest.fixture
def network():
    return MemoryNetwork()


@pytest.fixture(scope="session")
def empty_database(tmp_path_factory):
    """A database without rows, made once: migrations take longer than most tests."""
    path = tmp_path_factory.mktemp("database") / "server.db"
    store = Store(f"sqlite:///{path}")
    store.open()
    store.close()
    return path


@pytest.fixture
def config(tmp_path, empty_database) -> ServerConfig:
    shutil.copy(empty_database, tmp_path / "server.db")
    return ServerConfig(database_url=f"sqlite:///{tmp_path / 'server.db'}")


@pytest.fixture
def serving(network, config) -> Callable[..., AbstractAsyncContextManager[httpx.AsyncClient]]:
    """Function that runs a server and gives a client of it; `client.app` is the application."""

    @asynccontextmanager
    async def serve(token: str | None = None, **changes):
        app = create_app(config.model_copy(update=changes), transport=network.transport())
        headers = {} if token is None else {"Authorization": f"Bearer {token}"}
        wire = httpx.ASGITransport(app, raise_app_exceptions=False, client=("127.0.0.1", 50_000))
        async with (
            app.router.lifespan_context(app),
            httpx.AsyncClient(transport=wire, base_url="http://127.0.0.1", headers=headers) as client,
        ):
            client.app = app
            yield client

    return serve


@pytest.fixture
def vehicle(network):
    """Function that starts a publisher, car-7/roof unless named otherwise; all are stopped after the test."""
    started = []

    def start(
        settings: StreamSettings | None = None, name: str = "car-7", sensor: str = "roof", **changes: Any
    ) -> Publisher:
        """changes: settings that were changed before a server sees it."""
        publisher = Publisher(Loop(), settings, vehicle=name, sensor=sensor, transport=network.transport())
        publisher.change(**changes)
        started.append(publisher.start())
        return publisher

    yield start
    for one in started:
        one.stop()

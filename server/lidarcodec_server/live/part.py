"""The live part of the server, for the lifetime of the app."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import replace

from fastapi import FastAPI

from lidarcodec.transport import Endpoints, Transport, open_transport
from lidarcodec.transport.memory import MemoryTransport
from lidarcodec_server.config import ServerConfig
from lidarcodec_server.live.download import Downloads
from lidarcodec_server.live.hub import LiveHub
from lidarcodec_server.live.metrics import LiveMetrics
from lidarcodec_server.live.recordings import Recordings
from lidarcodec_server.live.running import Limits
from lidarcodec_server.live.seats import Seats
from lidarcodec_server.live.shelf import Shelf
from lidarcodec_server.service import Service


@asynccontextmanager
async def live(app: FastAPI) -> AsyncIterator[None]:
    """The hub and the recordings of an app, in `app.state`."""
    config: ServerConfig = app.state.config
    service: Service = app.state.service
    hub = LiveHub(
        lambda: service.transport,
        seats=Seats(config.max_viewers, config.max_viewers_a_client, config.max_viewers_a_host, config.proxies),
        ack_limit_s=config.ack_limit_s,
    )
    shelf = Shelf(config.recordings, max_total_bytes=config.max_recordings_bytes)
    limits = Limits(config.max_recording_s, config.max_recording_bytes)
    recordings = Recordings(shelf, hub, _opener(config, service), limits)
    app.state.hub, app.state.recordings, app.state.downloads = hub, recordings, Downloads()
    metrics = LiveMetrics(hub, recordings)
    service.metrics.registry.register(metrics)
    try:
        yield
    finally:
        service.metrics.registry.unregister(metrics)
        await recordings.close()
        await hub.close()


def _opener(config: ServerConfig, service: Service) -> Callable[[], Transport]:
    """Opens a second session, because a session does not receive its own messages."""

    def open_one() -> Transport:
        given = service.transport
        if isinstance(given, MemoryTransport):
            return given.network.transport()
        return open_transport(beside(config.endpoints))

    return open_one


def beside(endpoints: Endpoints) -> Endpoints:
    """Endpoints of a second session in the same process: it connects where the first one listens."""
    own = tuple(one.replace("/0.0.0.0:", "/127.0.0.1:").replace("/[::]:", "/[::1]:") for one in endpoints.listen)
    if not own:
        return endpoints
    return replace(endpoints, listen=(), connect=endpoints.connect + own, mode="client" if endpoints.mode else None)

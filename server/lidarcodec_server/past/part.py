"""The fetches of the server, for the lifetime of the app."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from fastapi import FastAPI
from starlette.concurrency import run_in_threadpool

from lidarcodec_server.config import ServerConfig
from lidarcodec_server.past.clips import Clips
from lidarcodec_server.past.fetches import Fetches
from lidarcodec_server.past.marked import Marked
from lidarcodec_server.past.spans import Spans
from lidarcodec_server.service import Service


@asynccontextmanager
async def past(app: FastAPI) -> AsyncIterator[None]:
    """The fetches of an app, and what its vehicles keep, in `app.state`."""
    config: ServerConfig = app.state.config
    service: Service = app.state.service
    fetches = Fetches(Clips(config.past, config.max_past_bytes), lambda: service.transport)
    app.state.fetches = fetches
    app.state.spans = Spans(lambda: service.transport, config.answer_s)
    await run_in_threadpool(fetches.start)
    marked = Marked(service.fleet, fetches, lambda: service.transport, config.answer_s)
    marked.start()
    try:
        yield
    finally:
        await run_in_threadpool(marked.close)
        await run_in_threadpool(fetches.close)

"""The archive of the server, for the lifetime of the app."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

from fastapi import FastAPI
from starlette.concurrency import run_in_threadpool

from lidarcodec.archive.archive import Archive
from lidarcodec.archive.stores.table import open_store
from lidarcodec.archive.table import check_extra
from lidarcodec.errors import SettingsError
from lidarcodec_server.archived.archived import Archived
from lidarcodec_server.config import ServerConfig

RETRY_S = 10
"""So long a request to a bucket is repeated: clients wait for it."""


@asynccontextmanager
async def archived(app: FastAPI) -> AsyncIterator[None]:
    """The archive of an app, in `app.state`; None without one."""
    config: ServerConfig = app.state.config
    app.state.archived = None
    if config.archive is None:
        yield
        return
    app.state.archived = await run_in_threadpool(_begun, config.archive)
    try:
        yield
    finally:
        await run_in_threadpool(app.state.archived.close)


def _begun(url: str) -> Archived:
    return Archived(opened(url))


def opened(url: str) -> Archive:
    """The archive. Raises MissingExtraError, UnknownNameError, SourceError, SettingsError without its folder."""
    check_extra()
    archive = Archive(open_store(url, RETRY_S))
    if "://" not in url and not Path(url).is_dir():
        raise SettingsError(f"there is no folder {url}", "--archive")
    return archive

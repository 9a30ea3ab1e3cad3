"""`/api/v1/session` and `/api/v1/settings`: what a user interface needs to know before it shows controls."""

from __future__ import annotations

from functools import cache
from typing import Any

from fastapi import APIRouter
from fastapi.requests import HTTPConnection
from pydantic import BaseModel, Field

import lidarcodec
from lidarcodec.codecs import table as codecs
from lidarcodec.ratecontrol.reach import FREE
from lidarcodec.reduction import table as reductions
from lidarcodec.settings import AUTO, StreamSettings
from lidarcodec_server.auth import Viewer, offers_token, require_viewer
from lidarcodec_server.config import Role
from lidarcodec_server.routes.common import TheService

router = APIRouter(prefix="/api/v1", tags=["session"])


class SessionAnswer(BaseModel):
    """The client and its permissions."""

    name: str | None = Field(description="Name of the token; the address of the client if no token is needed.")
    role: Role | None = Field(
        description="Viewers can look, operators can also change settings. null: a token is needed, but none was given."
    )
    token_needed: bool = Field(description="Whether other requests without a token are refused.")
    version: str = Field(description="Version of the server.")
    archive: bool = Field(description="Whether the server has an archive (`serve --archive`).")


@router.get("/session")
def session(service: TheService, connection: HTTPConnection) -> SessionAnswer:
    """The client as the server sees it. This needs no token, so that a page can ask whether one is needed. An invalid
    token is refused as everywhere."""
    needed, about = service.tokens.needed, {"version": lidarcodec.__version__, "archive": bool(service.config.archive)}
    if needed and not offers_token(connection):
        return SessionAnswer(name=None, role=None, token_needed=True, **about)
    client = require_viewer(connection)
    return SessionAnswer(name=client.name, role=client.role, token_needed=needed, **about)


@router.get("/settings")
def settings_schema(client: Viewer) -> dict[str, Any]:
    """JSON schema of the settings that all codecs have in common; `GET /api/v1/codecs` has each codec's own settings.
    `enum` lists the names that a setting allows; if it also allows other texts, `examples` lists them. `free` is the
    value of a setting that leaves it to the target bitrate."""
    return _schema()


@cache
def _schema() -> dict[str, Any]:
    schema = StreamSettings.model_json_schema()
    fields = schema["properties"]
    fields["codec"]["enum"] = [AUTO, *codecs.names()]
    fields["intensity"]["examples"] = ["auto", "lossless", "error=4", "levels=32", "levels=16", "levels=6", "off"]
    fields["framing"]["examples"] = ["revolution", "packets", "packets:29"]
    fields["reduction"]["examples"] = [reductions.example_of(name) for name in reductions.names()]
    for name, value in FREE.items():
        if value in (None, AUTO):
            fields[name]["free"] = value
    fields["reduction"]["budgeted"] = [name for name in reductions.names() if reductions.reduction(name).budgeted]
    return schema

"""`/api/v1/audit` and `/api/v1/streams/{vehicle}/{sensor}/audit`: who changed what, and when."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query

from lidarcodec_server.auth import Viewer
from lidarcodec_server.routes.common import TheService, TheStream
from lidarcodec_server.schemas import AuditEntry

router = APIRouter(prefix="/api/v1", tags=["settings"])

Limit = Annotated[int, Query(ge=1, le=1000)]
Before = Annotated[int | None, Query(ge=1, le=2**62, description="Continue after the entry with this id.")]


@router.get("/audit")
def whole(service: TheService, client: Viewer, limit: Limit = 100, before: Before = None) -> list[AuditEntry]:
    """Entries of the audit log, newest first: of all streams, and entries without a stream, such as tokens."""
    return [AuditEntry.of(entry) for entry in service.audit(None, limit, before)]


@router.get("/streams/{vehicle}/{sensor}/audit")
def audit(
    service: TheService, keys: TheStream, client: Viewer, limit: Limit = 100, before: Before = None
) -> list[AuditEntry]:
    """Entries of the audit log about a stream, newest first."""
    return [AuditEntry.of(entry) for entry in service.audit(keys, limit, before)]

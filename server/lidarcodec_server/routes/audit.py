"""`/api/v1/streams/{vehicle}/{sensor}/audit`: who changed what, and when."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query

from lidarcodec_server.auth import Viewer
from lidarcodec_server.routes.common import TheService, TheStream
from lidarcodec_server.schemas import AuditEntry

router = APIRouter(prefix="/api/v1/streams/{vehicle}/{sensor}", tags=["settings"])


@router.get("/audit")
def audit(
    service: TheService,
    keys: TheStream,
    client: Viewer,
    limit: Annotated[int, Query(ge=1, le=1000)] = 100,
    before: Annotated[int | None, Query(ge=1, le=2**62, description="Go on behind this id.")] = None,
) -> list[AuditEntry]:
    """Entries of the audit log, newest first."""
    return [AuditEntry.of(entry) for entry in service.store.audit(keys, limit, before)]

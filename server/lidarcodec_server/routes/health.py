"""`/healthz` and `/readyz`: for programs that start or monitor the server. They need no token, so they say little."""

from __future__ import annotations

from fastapi import APIRouter, Response

from lidarcodec_server.routes.common import TheService

router = APIRouter(tags=["health"])


@router.get("/healthz")
async def healthz() -> dict[str, bool]:
    """Whether the process answers."""
    return {"ok": True}


@router.get("/readyz", responses={503: {"description": "Not ready. The answer says which part."}})
def readyz(service: TheService, response: Response) -> dict[str, bool]:
    """Whether the Zenoh session is open and the store answers."""
    parts = service.ready()
    if not all(parts.values()):
        response.status_code = 503
    return parts

"""`/metrics`: for Prometheus."""

from __future__ import annotations

from fastapi import APIRouter, Response
from starlette.requests import Request

from lidarcodec_server.auth import require_viewer
from lidarcodec_server.metrics.metrics import MEDIA_TYPE
from lidarcodec_server.routes.common import TheService

router = APIRouter(tags=["health"])


@router.get("/metrics", response_class=Response, responses={200: {"content": {"text/plain": {}}}})
def metrics(request: Request, service: TheService) -> Response:
    """Metrics of every stream and of the server, in Prometheus' text format."""
    if not service.config.metrics_open:
        require_viewer(request)
    return Response(service.metrics.text(), media_type=MEDIA_TYPE)

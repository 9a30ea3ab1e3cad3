"""`/`, `/docs` and `/openapi.json`: the pages for people. Pages contain no data and need no token."""

from __future__ import annotations

import base64
import re
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any

from fastapi import APIRouter
from starlette.requests import Request
from starlette.responses import HTMLResponse, Response

from lidarcodec_server.auth import Viewer
from lidarcodec_server.problems import ProblemError
from lidarcodec_server.web_files import WebFile, web_files

router = APIRouter(include_in_schema=False)

DOCS = Path(__file__).parent.parent / "docs.html"
POLICY = (
    "default-src 'none'; script-src 'self' 'wasm-unsafe-eval'; style-src 'self'; img-src 'self' data: blob:; "
    "connect-src 'self' data:; worker-src 'self' blob:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
"""The page may load files of this server only: no inline scripts, and nothing from other servers. The zstd decoder
loads its own code from a `data:` URL."""


@router.get("/openapi.json")
def openapi(request: Request, client: Viewer) -> dict[str, Any]:
    """The OpenAPI document, for programs."""
    document: dict[str, Any] = request.app.openapi()
    return document


@router.get("/docs")
def docs() -> HTMLResponse:
    """The OpenAPI document as a page, for people. It loads nothing from other servers."""
    html = DOCS.read_text(encoding="utf-8")
    return HTMLResponse(html, headers={"Content-Security-Policy": _policy(html), "Cache-Control": "no-cache"})


@router.get("/")
def front(request: Request) -> Response:
    """The page."""
    return _file(request, "index.html")


@router.get("/icon.svg")
def icon(request: Request) -> Response:
    """The page's icon."""
    return _file(request, "icon.svg")


@router.get("/assets/{name}")
def asset(request: Request, name: str) -> Response:
    """A file that the page loads."""
    return _file(request, f"assets/{name}")


def _file(request: Request, name: str) -> Response:
    file = web_files().get(name)
    if file is None:
        raise ProblemError(404, f"there is no '{name}': reload the page, which may be of an older version")
    headers = {"Cache-Control": file.cache_control, "ETag": file.etag, "Vary": "Accept-Encoding"}
    if file.name.endswith((".html", ".svg")):
        headers["Content-Security-Policy"] = POLICY
    if file.etag in request.headers.get("if-none-match", ""):
        return Response(status_code=304, headers=headers)
    return _answer(file, headers, request.headers.get("accept-encoding", ""))


def _answer(file: WebFile, headers: dict[str, str], accepted: str) -> Response:
    body = file.compressed if "gzip" in accepted.lower() else None
    if body is not None:
        headers["Content-Encoding"] = "gzip"
    return Response(body or file.content, headers=headers, media_type=file.media_type)


@cache
def _policy(html: str) -> str:
    """A content security policy that allows the page's inline scripts and styles, by hash, and requests to this
    server.
    """

    def hashes(tag: str) -> str:
        found = re.findall(rf"<{tag}>(.*?)</{tag}>", html, flags=re.DOTALL)
        digests = [base64.b64encode(sha256(one.encode()).digest()).decode() for one in found]
        return " ".join(f"'sha256-{digest}'" for digest in digests) or "'none'"

    return (
        f"default-src 'none'; script-src {hashes('script')}; style-src {hashes('style')}; connect-src 'self'; "
        "base-uri 'none'; form-action 'self'; frame-ancestors 'none'"
    )

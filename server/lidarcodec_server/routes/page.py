"""`/`, `/docs` and `/openapi.json`: what a person sees first. Pages hold no data and need no token."""

from __future__ import annotations

import base64
import re
from functools import cache
from hashlib import sha256
from html import escape
from pathlib import Path
from typing import Any

from fastapi import APIRouter
from starlette.requests import Request
from starlette.responses import HTMLResponse

from lidarcodec_server.auth import Viewer

router = APIRouter(include_in_schema=False)

DOCS = Path(__file__).parent.parent / "docs.html"


@router.get("/openapi.json")
def openapi(request: Request, client: Viewer) -> dict[str, Any]:
    """The interface, for programs."""
    document: dict[str, Any] = request.app.openapi()
    return document


@router.get("/docs")
def docs() -> HTMLResponse:
    """The interface, for people; nothing is loaded from elsewhere."""
    return _page(DOCS.read_text(encoding="utf-8"))


@router.get("/")
def front(request: Request) -> HTMLResponse:
    """Which routes there are."""
    rows = "".join(
        f"<tr><td>{method.upper()}<td><code>{escape(path)}</code><td>{escape(about.get('description', ''))}"
        for path, methods in request.app.openapi()["paths"].items()
        for method, about in methods.items()
    )
    return _page(
        "<!doctype html><html lang=en><meta charset=utf-8><title>lidarcodec server</title>"
        "<style>body{font:16px/1.5 system-ui,sans-serif;margin:2rem}td{vertical-align:top}</style>"
        "<h1>lidarcodec server</h1><p>It runs, and this is what it answers. <a href=/docs>/docs</a> says more; "
        "<code>lidarcodec subscribe</code> and the programs in <code>clients/</code> show streams."
        f"<table>{rows}</table>"
    )


@cache
def _policy(html: str) -> str:
    """A content security policy that allows what stands in the page, by hash, and requests to this server."""

    def hashes(tag: str) -> str:
        found = re.findall(rf"<{tag}>(.*?)</{tag}>", html, flags=re.DOTALL)
        digests = [base64.b64encode(sha256(one.encode()).digest()).decode() for one in found]
        return " ".join(f"'sha256-{digest}'" for digest in digests) or "'none'"

    return (
        f"default-src 'none'; script-src {hashes('script')}; style-src {hashes('style')}; connect-src 'self'; "
        "base-uri 'none'; form-action 'self'; frame-ancestors 'none'"
    )


def _page(html: str) -> HTMLResponse:
    return HTMLResponse(html, headers={"Content-Security-Policy": _policy(html), "Cache-Control": "no-cache"})

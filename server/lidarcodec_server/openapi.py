"""The OpenAPI document: every route, with its possible problems and the token that it needs.

`python -m lidarcodec_server.openapi docs/openapi.json` writes it; a test compares the two.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi

from lidarcodec_server.problems import MEDIA_TYPE

PROBLEM = {
    "type": "object",
    "title": "Problem",
    "description": "An error (RFC 9457).",
    "required": ["type", "title", "status", "detail"],
    "properties": {
        "type": {"type": "string", "description": "`urn:lidarcodec:problem:NAME`, or `about:blank`."},
        "title": {"type": "string"},
        "status": {"type": "integer"},
        "detail": {"type": "string", "description": "What is wrong, and how to correct it."},
        "field": {"type": "string", "description": "The setting or parameter that is wrong."},
        "errors": {"type": "array", "items": {"type": "object"}, "description": "All errors of a request."},
        "instance": {"type": "string", "description": "Where the server's log has an unexpected error."},
    },
}
OPEN = ("/healthz", "/readyz")
ALWAYS = {
    "400": "Not a valid request.",
    "401": "Without a valid token.",
    "403": "A viewer may not do this, or the request comes from a page of another origin.",
    "404": "Never seen.",
    "405": "This path does not have this method.",
    "408": "The body did not arrive in time.",
    "413": "The body is too long.",
    "415": "The content type of the body is not JSON.",
    "422": "Not allowed: `detail` says why, and `field` where.",
    "429": "Too many requests; `Retry-After` says when to try again.",
    "500": "Unexpected error; the log has the details under `instance`.",
    "503": "The vehicle, the network or the store does not answer; `Retry-After` says when to try again.",
}


def document(app: FastAPI) -> Callable[[], dict[str, Any]]:
    """A function that gives the app's document."""

    def openapi() -> dict[str, Any]:
        if app.openapi_schema is None:
            made = get_openapi(title=app.title, version=app.version, summary=app.summary, routes=app.routes)
            app.openapi_schema = _finished(made)
        return app.openapi_schema

    return openapi


def _finished(made: dict[str, Any]) -> dict[str, Any]:
    schemas = made.setdefault("components", {}).setdefault("schemas", {})
    for unused in ("HTTPValidationError", "ValidationError"):
        schemas.pop(unused, None)
    schemas["Problem"] = PROBLEM
    made["components"]["securitySchemes"] = {"token": {"type": "http", "scheme": "bearer"}}
    content = {MEDIA_TYPE: {"schema": {"$ref": "#/components/schemas/Problem"}}}
    for path, methods in made["paths"].items():
        for about in methods.values():
            if path not in OPEN:
                about["security"] = [{"token": []}, {}]
            for status, text in ALWAYS.items():
                given = about["responses"].get(status, {})
                own = given.get("description", "")
                about["responses"][status] = {
                    "description": text if own in ("", "Validation Error") else own,
                    "content": content if status == "422" or "content" not in given else given["content"] | content,
                }
    return made


def text(app: FastAPI) -> str:
    """The document in the form of docs/openapi.json."""
    return json.dumps(app.openapi(), indent=1, sort_keys=True) + "\n"


if __name__ == "__main__":
    from lidarcodec_server.app import create_app
    from lidarcodec_server.config import ServerConfig

    Path(sys.argv[1]).write_text(text(create_app(ServerConfig(database_url="sqlite://"))), encoding="utf-8")

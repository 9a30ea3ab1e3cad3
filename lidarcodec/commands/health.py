"""`lidarcodec health`: checks whether a publisher or a server on this machine works. The result is the exit code."""

from __future__ import annotations

import http.client
import ssl
import time
import urllib.error
import urllib.request
from ipaddress import ip_address
from pathlib import Path
from urllib.parse import urlsplit

from lidarcodec.apps import health
from lidarcodec.commands.running.telling import tell
from lidarcodec.errors import SettingsError, SourceError
from lidarcodec.untrusted.json import JsonRefusedError, read_object

ANSWER_S = 5.0
MAX_ANSWER_BYTES = 4096


def run(file: Path | None, url: str | None, as_json: bool = False) -> None:
    """Print `well` if it works; as JSON also what is wrong.

    Raises SourceError if something is wrong, SettingsError unless exactly one of both arguments is given.
    """
    if (file is None) == (url is None):
        raise SettingsError("health needs --health-file FILE for a publisher, or --url URL for a server", "url")
    wrong = health.complaints(health.read(file), time.monotonic()) if file is not None else _of_server(str(url))
    if not wrong or as_json:
        tell({"well": not wrong, "wrong": wrong}, "well", as_json)
    if wrong:
        raise SourceError("; ".join(wrong))


def _of_server(url: str) -> list[str]:
    parts = urlsplit(url)
    if parts.scheme not in ("http", "https") or not parts.hostname:
        raise SettingsError(f"{url} is not the address of a server: write for example http://127.0.0.1:8080", "url")
    handlers: list[urllib.request.BaseHandler] = [urllib.request.ProxyHandler({})]
    if parts.scheme == "https":
        handlers.append(urllib.request.HTTPSHandler(context=_trust(parts.hostname)))
    try:
        with urllib.request.build_opener(*handlers).open(f"{url.rstrip('/')}/readyz", timeout=ANSWER_S) as answer:
            answer.read(MAX_ANSWER_BYTES)
    except urllib.error.HTTPError as error:
        with error:
            return [f"{url} is not ready: {_away(error.read(MAX_ANSWER_BYTES)) or error.code}"]
    except (OSError, http.client.HTTPException) as error:
        return [f"{url} does not answer: {getattr(error, 'reason', None) or error}"]
    return []


def _away(body: bytes) -> str:
    """The parts that are not ready, from an answer of `/readyz`; empty for any other answer."""
    try:
        return ", ".join(name for name, ready in read_object(body, MAX_ANSWER_BYTES).items() if ready is False)
    except JsonRefusedError:
        return ""


def _trust(host: str) -> ssl.SSLContext:
    """Check certificates as usual. On loopback accept any certificate: it is issued for another name, and no other
    machine can listen there."""
    context = ssl.create_default_context()
    try:
        loopback = ip_address(host).is_loopback
    except ValueError:
        loopback = host == "localhost"
    if loopback:
        context.check_hostname = False
        context.verify_mode = ssl.CERT_NONE
    return context

"""Origins: which web pages may be viewers of a bridge.

A browser lets any page open a WebSocket to this machine, and says in the field `Origin` where the page came from.

>>> page = "GET / HTTP/1.1\\r\\nHost: localhost:8765\\r\\nOrigin: {}\\r\\n\\r\\n"
>>> of = lambda origin: Origins(["https://lichtblick.example"]).refusal(page.format(origin).encode())
>>> of("https://app.foxglove.dev"), of("https://lichtblick.example"), of("http://localhost:8080"), of("file://")
(None, None, None, None)
>>> of("https://news.example")
'a web page from https://news.example is not allowed: --allow-origin allows it'
"""

from __future__ import annotations

import ipaddress
from collections.abc import Sequence
from typing import Final
from urllib.parse import urlsplit

from lidarcodec.errors import SettingsError
from lidarcodec.untrusted.text import one_line

USUAL: Final = ("https://app.foxglove.dev", "https://studio.foxglove.dev")
"""Foxglove in a browser."""
_MOST_LETTERS: Final = 100


class Origins:
    """Pages of Foxglove, of this machine, and those of `more` origins. Programs that are no browser say no origin."""

    def __init__(self, more: Sequence[str] = ()) -> None:
        """Raises SettingsError for what is no origin."""
        for one in more:
            parts = urlsplit(one)
            if parts.scheme not in ("http", "https") or not parts.netloc or one != f"{parts.scheme}://{parts.netloc}":
                raise SettingsError(f"'{one[:_MOST_LETTERS]}' is no origin: write https://HOST or http://HOST:PORT")
        self._allowed = frozenset(one.lower() for one in (*USUAL, *more))

    def refusal(self, head: bytes) -> str | None:
        """Why the request with this head is refused; None if it is not."""
        origins, host = _fields(head, b"origin"), (_fields(head, b"host") or [""])[0]
        for origin in origins:
            if not self._may(origin, host):
                shown = one_line(origin[:_MOST_LETTERS])
                return f"a web page from {shown} is not allowed: --allow-origin allows it"
        return None

    def _may(self, origin: str, host: str) -> bool:
        scheme, found, place = origin.lower().partition("://")
        if origin.lower() in self._allowed or (found and scheme not in ("http", "https")):
            return True  # pages of programs on this machine have schemes of their own
        name = _name(place)
        if name == "localhost" or name.endswith(".localhost"):
            return True
        address = _address(name)
        # An address cannot be made to mean another machine, as a name can.
        return address is not None and (address.is_loopback or address == _address(_name(host)))


def _fields(head: bytes, name: bytes) -> list[str]:
    lines = (line.partition(b":") for line in head.split(b"\n")[1:])
    return [value.strip().decode("latin-1") for field, _, value in lines if field.strip().lower() == name]


def _name(place: str) -> str:
    """The host of `HOST:PORT`."""
    try:
        return urlsplit(f"//{place}").hostname or ""
    except ValueError:
        return ""


def _address(name: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    try:
        return ipaddress.ip_address(name)
    except ValueError:
        return None

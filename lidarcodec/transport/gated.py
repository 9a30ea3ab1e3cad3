"""Which listeners of a configuration get a gate in front, and the configuration of Zenoh behind it."""

from __future__ import annotations

import logging
import os
import re
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any, Final, NamedTuple

from lidarcodec.errors import TransportError
from lidarcodec.gate.gate import Gate, listener_at
from lidarcodec.gate.limits import Limits
from lidarcodec.transport.endpoints import free_port

logger = logging.getLogger(__name__)

VARIABLE: Final = "LIDARCODEC_GATE"
_TLS: Final = re.compile(r"tls/(?:\[(?P<v6>[^\]]+)\]|(?P<host>[^:/?#]+)):(?P<port>\d+)(?P<rest>[?#]\S*)?")
_PATH: Final = "listen/endpoints"


class Behind(NamedTuple):
    """gate: the process in front, None without one;  options: what Zenoh's configuration gets instead, by path"""

    gate: Gate | None
    options: dict[str, Any]


def wanted() -> bool:
    """Whether LIDARCODEC_GATE allows a gate; it does unless it says `off`.

    Raises TransportError for another word.
    """
    word = os.environ.get(VARIABLE) or "on"
    if word not in ("on", "off"):
        raise TransportError(f"{VARIABLE} must be on or off, not '{word}'")
    return word == "on"


def put_behind(option: Callable[[str], Any]) -> Behind:
    """Start a gate for the TLS endpoints that a configuration listens at; without such an endpoint, none.

    option: gives the value at a path of the configuration
    Raises TransportError when an address cannot be used, or no process can be started.
    """
    mode, given = option("mode") or "peer", option(_PATH)
    endpoints = given.get(mode) if isinstance(given, dict) else given
    if not isinstance(endpoints, list) or not any(_tls(one) for one in endpoints) or not wanted():
        return Behind(None, {})
    why_not = _obstacle(option, mode, endpoints)
    if why_not is not None:
        logger.warning(
            "the TLS port is not protected by the gate, because %s: strangers can block it for everybody", why_not
        )
        return Behind(None, {})
    inner: list[Any] = []
    with ExitStack() as held:
        listeners = []
        for endpoint in endpoints:
            found = _tls(endpoint)
            if found is None:
                inner.append(endpoint)
                continue
            listener = held.enter_context(listener_at(found["v6"] or found["host"], int(found["port"])))
            listeners.append((listener, free_port()))
            inner.append(f"tls/127.0.0.1:{listeners[-1][1]}{found['rest'] or ''}")
        held.pop_all()
    limits = Limits(mutual=option("transport/link/tls/enable_mtls") is True)
    return Behind(Gate(listeners, limits), {_PATH: inner})


def _tls(endpoint: Any) -> re.Match[str] | None:
    return _TLS.fullmatch(endpoint) if isinstance(endpoint, str) else None


def _obstacle(option: Callable[[str], Any], mode: str, endpoints: list[Any]) -> str | None:
    """Why Zenoh must listen itself; None if it need not."""
    gossip = option("scouting/gossip/enabled")
    if (gossip.get(mode) if isinstance(gossip, dict) else gossip) is not False:
        return "gossip is on and tells others the address at which Zenoh listens (scouting/gossip/enabled)"
    if any("iface=" in str(one) for one in endpoints):
        return "the endpoint names an interface (iface)"
    subjects = option("access_control/subjects") or []
    if any(isinstance(one, dict) and one.get("interfaces") for one in subjects):
        return "rules of access control go by interface"
    return None

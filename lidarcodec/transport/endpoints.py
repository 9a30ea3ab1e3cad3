"""Where to listen and connect, and the Zenoh configuration for it. Imports no library of networks.

By default nothing leaves the machine: every process listens on its own loopback port, all meet at one known port
(7447), find each other there and connect directly.
"""

from __future__ import annotations

import os
import re
import socket
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, NamedTuple, Self

from lidarcodec.errors import TransportError
from lidarcodec.units import is_number
from lidarcodec.wire import MAX_MESSAGE

LOOPBACK = "tcp/127.0.0.1"
LOOPBACK_PORT = 7447
PORT_VARIABLE = "LIDARCODEC_LOOPBACK_PORT"
RETRY = {"period_init_ms": 100, "period_max_ms": 500, "period_increase_factor": 2}
"""Interval of retries. With the library's default a stream may need 4 s after a long outage, with this 0.5 s."""
OPEN_TIMEOUT_MS = 500
LOCAL_OPEN_TIMEOUT_MS = 1000
"""Longest delay of the start by another program at the meeting point."""
LARGEST = MAX_MESSAGE + (1 << 20)
"""Bytes of the largest message that a link puts together, with what Zenoh adds. A longer one is dropped while it comes,
and the link goes on; without this limit it is 1 GiB, in the memory of every receiver."""
_ENDPOINT = re.compile(
    r"(?P<kind>tcp|udp|tls|quic|ws)/(?:\[[^\s\[\]]+\]|[^\s:/\[\]]+):(?P<port>[0-9]{1,5})"
    r"(?:\?[^\s#]*)?(?:#(?P<options>\S*))?|unixsock-stream/\S+"
)
_ON_THIS_MACHINE = re.compile(r"unixsock-stream/|[a-z]+/(?:127(?:\.\d{1,3}){3}|localhost|\[::1\]):", re.IGNORECASE)
_NUMBERS = ("so_sndbuf", "so_rcvbuf")
_OPTIONS = {"tcp": {"iface", "bind", "dscp", *_NUMBERS}, "udp": {"iface", "bind", "dscp", "join"}, "ws": {"dscp"}}
"""What may stand behind # by kind of endpoint. Zenoh ignores what it does not know and tries what it cannot use
for ever, without a word. Options of tls and quic are many, and most belong into a configuration file: not checked."""

Mode = Literal["peer", "client", "router"]


def default_loopback_port() -> int:
    """7447, or what LIDARCODEC_LOOPBACK_PORT says.

    Raises TransportError when that is no port.
    """
    text = os.environ.get(PORT_VARIABLE, "")
    if not text:
        return LOOPBACK_PORT
    if not is_number(text, 65535, 1):
        raise TransportError(f"{PORT_VARIABLE} must be 1 to 65535, not '{text}'")
    return int(text)


def free_port() -> int:
    """A TCP port of loopback that nobody listens on now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def _check_options(endpoint: str, kind: str, options: str | None) -> None:
    """Raise TransportError for what stands behind # and is no option of that kind of endpoint."""
    known = _OPTIONS.get(kind)
    if options is None or known is None:
        return
    for option in options.split(";"):
        name, _, value = option.partition("=")
        if name not in known:
            raise TransportError(
                f"'{endpoint}': {kind} has no option '{name}': choose one of {', '.join(sorted(known))}"
            )
        if not value or (name in _NUMBERS and not is_number(value, 2**31 - 1)):
            raise TransportError(f"'{endpoint}': {name} needs a {'number' if name in _NUMBERS else 'value'}")


class Party(NamedTuple):
    """The party to which a configuration of `lidarcodec certs` belongs."""

    role: str
    name: str


@dataclass(frozen=True)
class Endpoints:
    """Where a session listens and connects.

    listen, connect: Zenoh endpoints such as `tcp/192.168.1.5:7447`
    config: a whole Zenoh configuration file (JSON5), used as it is; listen and connect, if given, are put over it
    mode: by default `client` when there is only something to connect to (behind a router peers that do not listen hear
        nothing of each other, and nothing says so), else `peer`
    loopback_port: where processes of this machine meet when nothing else is given (7447, or LIDARCODEC_LOOPBACK_PORT)
    """

    listen: tuple[str, ...] = ()
    connect: tuple[str, ...] = ()
    config: Path | None = None
    mode: Mode | None = None
    loopback_port: int = field(default_factory=default_loopback_port)

    def __post_init__(self) -> None:
        for endpoint in self.listen + self.connect:
            found = _ENDPOINT.fullmatch(endpoint)
            if found is None or int(found["port"] or 0) > 65535:
                raise TransportError(f"'{endpoint}' is not an endpoint: write for example tcp/192.168.1.5:7447")
            _check_options(endpoint, found["kind"] or "", found["options"])
        if self.mode not in (None, "peer", "client", "router"):
            raise TransportError(f"mode must be peer, client or router, not '{self.mode}'")
        if self.mode == "client" and self.listen:
            raise TransportError("mode=client cannot listen: leave out mode or listen")
        if self.mode == "client" and not self.connect and self.config is None:
            raise TransportError("mode=client needs an endpoint: give one with connect")
        if not 1 <= self.loopback_port <= 65535:
            raise TransportError(f"loopback_port must be 1 to 65535, not {self.loopback_port}")
        if self.config is not None and not self.config.is_file():
            raise TransportError(f"there is no Zenoh configuration file {self.config}")

    @classmethod
    def of(
        cls,
        connect: str | tuple[str, ...] | list[str] | None = None,
        listen: str | tuple[str, ...] | list[str] | None = None,
        config: str | Path | None = None,
        mode: Mode | None = None,
        loopback_port: int | None = None,
    ) -> Self:
        """From options in simple forms: one endpoint or several, a path as text."""

        def several(given: str | tuple[str, ...] | list[str] | None) -> tuple[str, ...]:
            return (given,) if isinstance(given, str) else tuple(given or ())

        path = None if config is None else Path(config)
        port = default_loopback_port() if loopback_port is None else loopback_port
        return cls(several(listen), several(connect), path, mode, port)

    @property
    def local(self) -> bool:
        """Whether all data stays on this machine."""
        return not self.listen and not self.connect and self.config is None

    @property
    def on_this_machine(self) -> bool:
        """Whether all given endpoints are on this machine. A configuration file is not considered."""
        return self.config is None and all(_ON_THIS_MACHINE.match(one) for one in self.listen + self.connect)

    @property
    def rendezvous(self) -> str:
        """Endpoint at which processes of this machine meet."""
        return f"{LOOPBACK}:{self.loopback_port}"

    @property
    def effective_mode(self) -> Mode:
        """The mode of the session."""
        return self.mode or ("client" if self.connect and not self.listen else "peer")

    def options(self) -> dict[str, Any]:
        """Zenoh configuration by path, to be put over the defaults, or over the file."""
        if self.config is not None:
            mode = self.mode or ("peer" if self.listen else None)  # a client would not listen
            given = {"mode": mode, "listen/endpoints": list(self.listen), "connect/endpoints": list(self.connect)}
            return {path: value for path, value in given.items() if value}
        if self.local:
            options = session_options(self.mode or "peer", [f"{LOOPBACK}:0"], [self.rendezvous])
            return options | {"transport/unicast/open_timeout": LOCAL_OPEN_TIMEOUT_MS}
        return session_options(self.effective_mode, list(self.listen), list(self.connect))

    def rendezvous_options(self) -> dict[str, Any]:
        """Configuration of the session at the meeting point; it carries no data."""
        return session_options("peer", [self.rendezvous], [])


def session_options(mode: Mode, listen: list[str], connect: list[str]) -> dict[str, Any]:
    """Configuration by path: only the given endpoints, no multicast, and connections that are tried for ever.

    Shared memory stays off: at 150 kB it gains nothing and makes the first message 10 to 25 ms late.
    """
    return {
        "mode": mode,
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": True,
        "listen/endpoints": listen,
        "connect/endpoints": connect,
        "connect/exit_on_failure": mode == "client",
        "connect/timeout_ms": OPEN_TIMEOUT_MS if mode == "client" else -1,
        "connect/retry": RETRY,
        "transport/shared_memory/enabled": False,
        "transport/link/rx/max_message_size": LARGEST,
    }

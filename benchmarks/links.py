"""Links whose rate changes while they carry a stream: two network namespaces with `tc tbf`, or a relay on loopback.

Both have `listen` for the publisher, `connect` for the receiver, `command` that puts a process on its side, and `rate`.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Callable
from typing import Protocol, Self

from tests.apps.relay import Relay

BURST, QUEUE = "16kb", "64kb"
"""Of the token bucket: what goes at once, and what waits before it is dropped, as behind a modem with a small queue."""


class Link(Protocol):
    """A way from a publisher to a receiver."""

    listen: str
    connect: str

    def command(self, side: str, command: list[str]) -> list[str]:
        """The command as it runs on the side of the `publisher` or of the `receiver`."""

    def rate(self, kbit: float) -> None:
        """From now on carry so much from the publisher to the receiver."""

    def close(self) -> None: ...


def _run(*command: str) -> None:
    subprocess.run(command, check=True, capture_output=True, text=True)


class Namespaces:
    """Two namespaces joined by a pair of virtual interfaces. Needs root and the commands `ip` and `tc`."""

    def __init__(self, kbit: float) -> None:
        """Raises CalledProcessError where the machine does not allow it."""
        number = os.getpid()
        self._sides = {"publisher": f"lidar{number}a", "receiver": f"lidar{number}b"}
        self._device = f"lc{number}a"
        self.listen = self.connect = "tcp/10.77.0.1:7447"
        near, far = self._sides.values()
        try:
            for one in (near, far):
                _run("ip", "netns", "add", one)
            peer = f"lc{number}b"
            _run("ip", "link", "add", self._device, "netns", near, "type", "veth", "peer", "name", peer, "netns", far)
            for name, device, address in ((near, self._device, "10.77.0.1/24"), (far, peer, "10.77.0.2/24")):
                _run("ip", "-n", name, "addr", "add", address, "dev", device)
                for up in (device, "lo"):
                    _run("ip", "-n", name, "link", "set", up, "up")
            self.rate(kbit)
        except BaseException:
            self.close()
            raise

    @staticmethod
    def missing() -> str | None:
        """Why there are no namespaces here; None when there are."""
        if os.geteuid() != 0:
            return "network namespaces need root"
        for tool in ("ip", "tc"):
            if shutil.which(tool) is None:
                return f"network namespaces need the command {tool}"
        try:
            Namespaces(1000).close()
        except subprocess.CalledProcessError as error:
            return f"no network namespaces here: {error.stderr.strip()}"
        return None

    def command(self, side: str, command: list[str]) -> list[str]:
        return ["ip", "netns", "exec", self._sides[side], *command]

    def rate(self, kbit: float) -> None:
        token_bucket = ("tbf", "rate", f"{kbit:.0f}kbit", "burst", BURST, "limit", QUEUE)
        inside = ("ip", "netns", "exec", self._sides["publisher"])
        _run(*inside, "tc", "qdisc", "replace", "dev", self._device, "root", *token_bucket)

    def close(self) -> None:
        for name in self._sides.values():
            subprocess.run(["ip", "netns", "delete", name], capture_output=True, check=False)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()


class Relayed:
    """A relay on loopback; `delay_s` each way."""

    def __init__(self, kbit: float, *, free_port: Callable[[], int], delay_s: float = 0.0) -> None:
        port = free_port()
        self._relay = Relay(port, kbit=kbit, delay_s=delay_s)
        self.listen, self.connect = f"tcp/127.0.0.1:{port}", f"tcp/127.0.0.1:{self._relay.port}"

    def command(self, side: str, command: list[str]) -> list[str]:
        return command

    def rate(self, kbit: float) -> None:
        self._relay.kbit = kbit

    @property
    def carried(self) -> int:
        """Bytes that came from the publisher's side."""
        return self._relay.carried

    def close(self) -> None:
        self._relay.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

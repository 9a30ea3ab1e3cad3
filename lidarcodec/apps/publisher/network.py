"""Network: the transport of a publisher, opened here or given by the caller."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any, Final

from lidarcodec.transport import Endpoints, Transport, certificates_of, open_transport

OpenTransport = Callable[[threading.Event], Transport]
"""A function that opens a transport. Its argument is an event that makes it give up."""


class Network:
    """Opens a transport, and closes it unless the caller gave it.

    endpoints: where to listen and connect; None: nothing leaves the machine
    given: an open transport, or a function that opens one; endpoints then only describe it

    Raises TransportError for an invalid configuration file.
    """

    def __init__(self, endpoints: Endpoints | None, given: Transport | OpenTransport | None) -> None:
        self._own: Final = given is None
        self.endpoints: Final = endpoints or Endpoints()
        self.one_machine: Final = self.endpoints.local and (endpoints is not None or given is None)
        """Whether all receivers are on this machine."""
        self._certificates = certificates_of(endpoints)
        self.transport: Transport | None = None
        self._open: OpenTransport = lambda stop: open_transport(endpoints, stop=stop)
        if callable(given):
            self._open = given
        else:
            self.transport = given

    def open(self, stop: threading.Event) -> Transport:
        """The open transport. Retries until it is open or `stop` is set.

        Raises TransportError if the endpoints cannot be used, or when stopped.
        """
        if self.transport is None:
            self.transport = self._open(stop)
        return self.transport

    def close(self) -> None:
        """Close the transport unless the caller gave it. A second call does nothing."""
        if self._own and self.transport is not None:
            self.transport.close()

    def certificate(self) -> dict[str, str] | None:
        """For the status: the certificate presented to receivers; None without one."""
        return None if self._certificates is None else self._certificates.told()

    def gate(self) -> dict[str, Any] | None:
        """For the status: counts of the gate in front of the TLS port; None without one."""
        return None if self.transport is None else self.transport.gate()

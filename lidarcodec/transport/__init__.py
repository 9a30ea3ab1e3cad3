"""Bytes on keys between processes. `base` is the interface, `zenoh` the network, `memory` a network in one process."""

from __future__ import annotations

from typing import TYPE_CHECKING

from lidarcodec.settings import is_name
from lidarcodec.transport.base import Transport
from lidarcodec.transport.certificates import Certificates, certificates_in
from lidarcodec.transport.endpoints import Endpoints, Party

if TYPE_CHECKING:
    from threading import Event

__all__ = ["Certificates", "Endpoints", "Party", "Transport", "certificates_of", "open_transport", "party_of"]


def open_transport(endpoints: Endpoints | None = None, *, stop: Event | None = None) -> Transport:
    """A Zenoh transport; without endpoints it stays on this machine.

    An unreachable router is tried again until it answers or `stop` is set.
    Raises TransportError for endpoints or a configuration that cannot be used, and when stopped.
    """
    from lidarcodec.transport.zenoh import ZenohTransport

    return ZenohTransport.open(endpoints or Endpoints(), stop=stop)


def party_of(endpoints: Endpoints | None) -> Party | None:
    """The party that a configuration file of `lidarcodec certs` is for; None for other files or without one.

    Raises TransportError for a file that is no Zenoh configuration.
    """
    if endpoints is None or endpoints.config is None:
        return None
    from lidarcodec.transport.zenoh_opening import options_in

    about = options_in(endpoints.config)("metadata")
    ours = about.get("lidarcodec") if isinstance(about, dict) else None
    if not isinstance(ours, dict) or not is_name(str(ours.get("name"))):
        return None
    return Party(str(ours.get("role")), str(ours["name"]))


def certificates_of(endpoints: Endpoints | None) -> Certificates | None:
    """The certificates in the configuration file of these endpoints; None if there are none.

    Raises TransportError for a file that is no Zenoh configuration.
    """
    if endpoints is None or endpoints.config is None:
        return None
    from lidarcodec.transport.zenoh_opening import options_in

    return certificates_in(options_in(endpoints.config))

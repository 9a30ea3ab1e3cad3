"""Zenoh configurations of a secured deployment: one for each router, vehicle, viewer and operator, whole in itself.

Certificates and keys are in the configuration, so that one file makes a machine part of the deployment. What a
configuration is for stands in its `metadata`, so that a program that is given one knows its own name.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from lidarcodec.transport.access import ROUTER, Auth, People, access_control, vehicles_only
from lidarcodec.transport.endpoints import OPEN_TIMEOUT_MS, Mode, session_options

Role = Literal["router", "vehicle", "viewer", "operator"]
SMALL_BUFFER = 65536
"""Bytes: what a router and a viewer let wait on a link, so that a slow viewer sees the newest frame and costs nobody
else. It must stay above rate x round trip: enough for 10 Mbit/s at 50 ms."""
TLS = "transport/link/tls"
USERS = "transport/auth/usrpwd"


@dataclass(frozen=True)
class Identity:
    """Who one party is: its name, and what proves it.

    ca, certificate, key: base64 of PEM; without `auth` by certificate only those who listen have the last two
    password: with `auth` by password
    """

    role: Role
    name: str
    ca: str
    certificate: str | None = None
    key: str | None = None
    password: str | None = None


@dataclass(frozen=True)
class Network:
    """What all parties have in common.

    auth:   how those who connect are known
    listen: endpoint at which routers listen, or vehicles when there is no router
    reach:  endpoints at which those are reached
    users:  file of users and passwords on the machine of a router, with `auth` by password
    """

    auth: Auth
    listen: str
    reach: tuple[str, ...]
    users: str | None = None


def accepting(identity: Identity, network: Network, people: People, onward: tuple[str, ...] = ()) -> dict[str, Any]:
    """Configuration by path of a router, or of a vehicle that is connected to directly; it holds the rules.

    onward: routers that this one connects to
    """
    mode: Mode = "router" if identity.role == "router" else "peer"
    options = session_options(mode, [network.listen], list(onward)) | _tls(identity, network)
    options |= {
        f"{TLS}/listen_certificate_base64": identity.certificate,
        f"{TLS}/listen_private_key_base64": identity.key,
        f"{TLS}/so_sndbuf": SMALL_BUFFER,
        "transport/link/tx/queue/size/data": 1,
        f"{TLS}/close_link_on_expiration": network.auth == "certificate",  # without, there is none that could expire
        "access_control": access_control(people, network.auth),
    }
    if network.auth == "password":
        options[f"{USERS}/dictionary_file"] = network.users
    return _without_gossip(options)


def connecting(identity: Identity, network: Network, people: People, *, routed: bool) -> dict[str, Any]:
    """Configuration by path of a party that connects: a client of the first router that answers, or, without routers,
    to every vehicle; then it holds the rules for what vehicles may say."""
    mode: Mode = "client" if routed else "peer"
    options = session_options(mode, [], list(network.reach)) | _tls(identity, network)
    if routed:
        options["connect/timeout_ms"] = OPEN_TIMEOUT_MS
    else:
        options["access_control"] = vehicles_only(people.vehicles, network.auth)
    if identity.role != "vehicle":
        options[f"{TLS}/so_rcvbuf"] = SMALL_BUFFER
    return _without_gossip(options)


def _tls(identity: Identity, network: Network) -> dict[str, Any]:
    """Options of TLS: the trusted authority, and our own certificate or password."""
    options: dict[str, Any] = {
        f"{TLS}/root_ca_certificate_base64": identity.ca,
        f"{TLS}/verify_name_on_connect": True,
        f"{TLS}/close_link_on_expiration": True,
        f"{TLS}/enable_mtls": network.auth == "certificate",
        "metadata": {"lidarcodec": {"role": identity.role, "name": identity.name}},
    }
    if network.auth == "certificate":
        options |= {
            f"{TLS}/connect_certificate_base64": identity.certificate,
            f"{TLS}/connect_private_key_base64": identity.key,
        }
    if network.auth == "password":
        options |= {
            f"{USERS}/user": ROUTER if identity.role == "router" else identity.name,
            f"{USERS}/password": identity.password,
        }
    return options


def _without_gossip(options: dict[str, Any]) -> dict[str, Any]:
    """Nobody is told of others' addresses: every connection goes where the configuration says."""
    return options | {"scouting/gossip/enabled": False}


def nested(options: Mapping[str, Any]) -> dict[str, Any]:
    """Options by path as one object, the form of a configuration file.

    >>> nested({"a/b": 1, "a/c": 2})
    {'a': {'b': 1, 'c': 2}}
    """
    out: dict[str, Any] = {}
    for path, value in options.items():
        *folders, last = path.split("/")
        place = out
        for folder in folders:
            place = place.setdefault(folder, {})
        place[last] = value
    return out

"""Secured deployments for tests: an authority, a router, and a configuration for each vehicle and person."""

from __future__ import annotations

from pathlib import Path

from lidarcodec.commands.certs import command as certs
from lidarcodec.transport import Endpoints, open_transport
from lidarcodec.transport.keys import StreamKeys
from tests.transport.conftest import free_port
from tests.transport.router import Router

CAR, OTHER = StreamKeys("car-7", "roof"), StreamKeys("car-8", "roof")
QUIET_S = 0.5
"""How long something forbidden has to stay away, after what is allowed came through on the same links."""


def deployment(folder, auth="certificate", routers=("localhost",), vehicles=("car-7", "car-8"), port=None, days=365):
    """A folder of configurations, and the port in them."""
    port = port or free_port()
    people = {"vehicles": vehicles, "viewers": ["anna", "ben"], "operators": ["olga"]}
    certs.run(folder, routers=routers, **people, auth=auth, port=port, days=days)
    return port


class Secured:
    """A deployment with its router running; sessions are opened by the name of their file."""

    def __init__(self, folder: Path, auth: str) -> None:
        self.folder, self.auth = folder, auth
        self.port = deployment(folder, auth)
        self.endpoint = f"tls/localhost:{self.port}"
        self.router = Router(config=str(folder / "router-localhost.json5"), listen=self.endpoint)
        self.opened = []

    def open(self, name: str):
        self.opened.append(open_transport(Endpoints.of(config=self.folder / f"{name}.json5")))
        return self.opened[-1]

    def close(self) -> None:
        for one in self.opened:
            one.close()
        self.router.kill()


def answering(car, keys, asked):
    """Have a vehicle answer its controls; `asked` gets the last part of each key that was."""
    for key in (
        keys.control_get,
        keys.control_set,
        keys.control_reset,
        keys.control_keyframe,
        keys.past,
        keys.past_mark,
    ):
        car.answer(key, lambda data, key=key: asked.append(key.rpartition("/")[2]) or b"yes")

"""`lidarcodec serve`: the server of a fleet, until a signal comes."""

from __future__ import annotations

from typing import Any

from lidarcodec.commands.endpoints import Given, endpoints_of
from lidarcodec.commands.server_extra import server_config, server_module


def run(given: Given, **values: Any) -> None:
    """Serve until a signal comes."""
    config = server_config(endpoints=endpoints_of(given), **values)
    server_module("serve").run(config)

"""`lidarcodec serve`: runs the server of a fleet until a signal arrives."""

from __future__ import annotations

import gc
from typing import Any

from lidarcodec.commands.endpoints import Given, endpoints_of
from lidarcodec.commands.running.stopping import stop_asked
from lidarcodec.commands.server_extra import server_config, server_module


def run(given: Given, as_json: bool = False, **values: Any) -> None:
    """Serve until a signal arrives."""
    config = server_config(endpoints=endpoints_of(given), **values)
    # A server for other machines must first check for tokens, and that needs its database.
    listener = server_module("door.listening").begin(config) if config.loopback else None
    gc.disable()  # while the server is imported: nothing of it can be freed, now or later
    try:
        server = server_module("serve")
    finally:
        gc.freeze()
        gc.enable()
    if not stop_asked():
        server.run(config, listener, as_json=as_json)

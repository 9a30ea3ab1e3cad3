"""Turns `--connect`, `--listen` and `--zenoh-config` into Endpoints."""

from __future__ import annotations

from pathlib import Path

from lidarcodec.errors import SettingsError, TransportError
from lidarcodec.transport import Endpoints

Given = tuple[list[str], list[str], Path | None]
"""Values of --connect, --listen and --zenoh-config."""


def endpoints_of(given: Given) -> Endpoints:
    """The endpoints on which to listen and to which to connect.

    Raises SettingsError for an invalid endpoint, TransportError when the configuration file is missing.
    """
    connect, listen, config = given
    if config is not None and not config.is_file():
        raise TransportError(f"there is no Zenoh configuration file {config}")
    try:
        return Endpoints.of(connect, listen, config)
    except TransportError as error:
        raise SettingsError(str(error)) from None

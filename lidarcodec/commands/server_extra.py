"""Access to the server's package, which is an extra. Only this module knows it, and imports it by name."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from lidarcodec.errors import MissingExtraError, SettingsError, sentence_of


def server_module(name: str) -> Any:
    """A module of the server.

    Raises MissingExtraError if its packages are not installed.
    """
    try:
        return import_module(f"lidarcodec_server.{name}")
    except ModuleNotFoundError as error:
        if error.name is not None and error.name.startswith("lidarcodec."):
            raise
        raise MissingExtraError("the server", "server") from None


def server_config(*, database_url: str | None = None, database_password_file: Path | None = None, **values: Any) -> Any:
    """A server's configuration. None means the default.

    Raises SettingsError if a value is not allowed, or there is no password in the file.
    """
    if database_password_file is not None:
        database_url = server_module("store.passwords").with_password(database_url, database_password_file)
    values["database_url"] = database_url
    try:
        return server_module("config").ServerConfig(**{name: one for name, one in values.items() if one is not None})
    except ValidationError as error:
        first = error.errors()[0]
        name = ".".join(str(part) for part in first["loc"])
        raise SettingsError(sentence_of(name or "the configuration", first), name) from None

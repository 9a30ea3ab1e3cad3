"""Changes of a publisher's settings by queries on its control keys, and what they result in."""

from __future__ import annotations

from typing import Any, Final, NamedTuple

from lidarcodec.errors import SettingsError
from lidarcodec.pipeline import check
from lidarcodec.settings import StreamSettings, is_name


class Applied(NamedTuple):
    """Result of a change: current settings, index of the first frame with them, whether it is a key frame."""

    settings: StreamSettings
    first_frame: int
    key: bool

    def answer(self) -> dict[str, Any]:
        """As the answer to a query."""
        return {"applied": self.settings.model_dump(), "first_frame": self.first_frame, "key": self.key}


MAX_BY: Final = 64
BY: Final = "by"
"""Field of a query that names its sender. It is not a setting."""


def asked_by(who: str) -> dict[str, str]:
    """The field of a query that names its sender, cut to what a vehicle takes."""
    text = "".join(one for one in who if one.isprintable())[:MAX_BY]
    return {BY: text} if text else {}


def asker(query: dict[str, Any]) -> str | None:
    """Take the name of the sender out of a query. None if it has none.

    Raises SettingsError if the name is not printable text of at most MAX_BY characters.
    """
    by = query.pop(BY, None)
    if by is not None and not (isinstance(by, str) and len(by) <= MAX_BY and by.isprintable()):
        raise SettingsError(f"{BY} must be a line of at most {MAX_BY} characters", BY)
    return by or None


def settings_with(settings: StreamSettings, changes: dict[str, Any]) -> StreamSettings:
    """Settings with some fields changed, checked together against their codec.

    Raises SettingsError or UnknownNameError.
    """
    for field in changes:
        if field not in StreamSettings.model_fields:
            known = ", ".join(StreamSettings.model_fields)
            raise SettingsError(f"unknown setting '{field}': choose one of {known}", field)
    _check_no_path(settings, changes)
    return check(settings.changed(**changes))


def _check_no_path(settings: StreamSettings, changes: dict[str, Any]) -> None:
    """Raises SettingsError for a codec setting that may be a path, so that queries cannot find out which files exist on
    this machine. Values from this machine's own command line are allowed.
    """
    given = changes.get("codec_settings")
    for name, value in given.items() if isinstance(given, dict) else ():
        ours = value == settings.codec_settings.get(name)
        if isinstance(value, str) and value and not ours and (not is_name(value) or value.endswith(".lcrw")):
            raise SettingsError(
                f"codec_settings.{name} must be a name, not a path (A-Z a-z 0-9 _ . -, at most 64 characters, "
                "no file ending). Only the vehicle's own command line takes paths",
                f"codec_settings.{name}",
            )

"""What a publisher answers on its control keys: JSON in, JSON out, and never an exception.

An error is `{"error": what is wrong and what would be right, "field": the setting or null}`, with `retry_s` where the
same query may be answered later.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Callable
from typing import Any, NamedTuple

from lidarcodec.errors import LidarCodecError, SettingsError, UnknownNameError
from lidarcodec.pipeline import check
from lidarcodec.settings import StreamSettings, is_name
from lidarcodec.untrusted.json import JsonRefusedError, read_object

logger = logging.getLogger(__name__)


class TooOftenError(SettingsError):
    """Something is asked too often; retry_s: when it may be asked again."""

    def __init__(self, what: str, retry_s: float) -> None:
        super().__init__(f"{what} too often: try again in {retry_s:.2f} s")
        self.retry_s = retry_s


class Applied(NamedTuple):
    """What became of a change: the settings in force, the first frame under them, whether a key frame comes."""

    settings: StreamSettings
    first_frame: int
    key: bool


def settings_with(settings: StreamSettings, changes: dict[str, Any]) -> StreamSettings:
    """Settings with some fields changed, checked as a whole against the codec that they name.

    Raises SettingsError or UnknownNameError; nothing is half taken.
    """
    for field in changes:
        if field not in StreamSettings.model_fields:
            known = ", ".join(StreamSettings.model_fields)
            raise SettingsError(f"unknown setting '{field}': known are {known}", field)
    _check_no_path(settings, changes)
    return check(settings.changed(**changes))


def _check_no_path(settings: StreamSettings, changes: dict[str, Any]) -> None:
    """Raises SettingsError for a text among a codec's settings that may be a path: what exists on this machine, and can
    be read, is secret. What is in force already, from this machine's command line, may be said again.
    """
    given = changes.get("codec_settings")
    for name, value in given.items() if isinstance(given, dict) else ():
        if not isinstance(value, str) or not value or value == settings.codec_settings.get(name):
            continue
        if not is_name(value) or value.endswith(".lcrw"):
            raise SettingsError(
                f"codec_settings.{name} must be a name here, not a path: 1 to 64 of A-Z a-z 0-9 _ . - and no file "
                "ending. Only the vehicle's own command line takes paths",
                f"codec_settings.{name}",
            )


def field_of(error: LidarCodecError) -> str | None:
    """The setting that an error is about."""
    if isinstance(error, SettingsError):
        return error.field
    return "codec" if isinstance(error, UnknownNameError) else None


def object_of(data: bytes) -> dict[str, Any]:
    """The JSON object of a query; an empty query is an empty object.

    Raises SettingsError.
    """
    try:
        return read_object(data or b"{}")
    except JsonRefusedError as error:
        raise SettingsError(f"cannot read the query: {error}") from None


def answered(answer: Callable[[dict[str, Any]], dict[str, Any]]) -> Callable[[bytes], bytes]:
    """A query handler: object in, object out; errors are sent back as the answer."""

    def handle(data: bytes) -> bytes:
        try:
            return json.dumps(answer(object_of(data)), allow_nan=False).encode()
        except LidarCodecError as error:
            out: dict[str, Any] = {"error": str(error), "field": field_of(error)}
            if isinstance(error, TooOftenError):
                out["retry_s"] = round(error.retry_s, 3)
        except Exception:
            logger.exception("a control query failed")
            out = {"error": "internal error; the publisher's log has the details", "field": None}
        return json.dumps(out).encode()

    return handle

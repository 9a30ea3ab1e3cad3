"""What a publisher answers on its control keys: JSON in, JSON out, and never an exception.

An error is `{"error": what is wrong and what would be right, "field": the setting or null}`.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Callable
from typing import Any, NamedTuple

from lidarcodec.apps.reports import finite, refuse_constant
from lidarcodec.errors import LidarCodecError, SettingsError, UnknownNameError
from lidarcodec.pipeline import check
from lidarcodec.settings import NAME_PATTERN, StreamSettings

logger = logging.getLogger(__name__)

MAX_QUERY_BYTES = 64 * 1024


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
    be read, is nobody else's business. What is in force already, from this machine's command line, may be said again.
    """
    given = changes.get("codec_settings")
    for name, value in given.items() if isinstance(given, dict) else ():
        if not isinstance(value, str) or not value or value == settings.codec_settings.get(name):
            continue
        if not NAME_PATTERN.fullmatch(value) or value.endswith(".lcrw"):
            raise SettingsError(
                f"codec_settings.{name} is a name from afar, of 1 to 64 of A-Z a-z 0-9 _ . - and without the ending "
                "of a file: paths are for the vehicle's own command line",
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
    if len(data) > MAX_QUERY_BYTES:
        raise SettingsError(f"a query of {len(data)} bytes: at most {MAX_QUERY_BYTES}")
    try:
        values = json.loads(data or b"{}", parse_constant=refuse_constant, parse_float=finite)
    except (ValueError, RecursionError):
        raise SettingsError("the query is no JSON, or holds a number that is none") from None
    if not isinstance(values, dict):
        raise SettingsError("the query is no JSON object")
    return values


def answered(answer: Callable[[dict[str, Any]], dict[str, Any]]) -> Callable[[bytes], bytes]:
    """A query handler: object in, object out; whatever goes wrong is told to whoever asked."""

    def handle(data: bytes) -> bytes:
        try:
            return json.dumps(answer(object_of(data)), allow_nan=False).encode()
        except LidarCodecError as error:
            out = {"error": str(error), "field": field_of(error)}
        except Exception:
            logger.exception("a control query failed")
            out = {"error": "internal error; the publisher's log has the details", "field": None}
        return json.dumps(out).encode()

    return handle

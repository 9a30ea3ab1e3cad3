"""A publisher's answers on its control keys: JSON in, JSON out. An error is also sent as an answer.

An error is `{"error": text with a remedy, "field": the setting or null}`, with `retry_s` where the same query may
succeed later.
"""

from __future__ import annotations

import json
import logging
import math
from collections.abc import Callable
from typing import Any, NamedTuple

from lidarcodec.errors import LidarCodecError, SettingsError, UnknownNameError
from lidarcodec.pipeline import check
from lidarcodec.settings import StreamSettings, is_name
from lidarcodec.untrusted.json import JsonRefusedError, read_object

logger = logging.getLogger(__name__)


class TooOftenError(SettingsError):
    """Queries came too often; retry_s: seconds until the next one is answered."""

    def __init__(self, what: str, retry_s: float) -> None:
        super().__init__(f"{what} too often: try again in {retry_s:.2f} s")
        self.retry_s = retry_s


class Applied(NamedTuple):
    """Result of a change: current settings, index of the first frame with them, whether it is a key frame."""

    settings: StreamSettings
    first_frame: int
    key: bool

    def answer(self) -> dict[str, Any]:
        """As the answer to a query."""
        return {"applied": self.settings.model_dump(), "first_frame": self.first_frame, "key": self.key}


def settings_with(settings: StreamSettings, changes: dict[str, Any]) -> StreamSettings:
    """Settings with some fields changed, checked together against their codec.

    Raises SettingsError or UnknownNameError.
    """
    for field in changes:
        if field not in StreamSettings.model_fields:
            known = ", ".join(StreamSettings.model_fields)
            raise SettingsError(f"unknown setting '{field}': known are {known}", field)
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
                out["retry_s"] = math.ceil(error.retry_s * 1000) / 1000
        except Exception:
            logger.exception("a control query failed")
            out = {"error": "internal error; the publisher's log has the details", "field": None}
        return json.dumps(out).encode()

    return handle

"""Answers to queries: JSON in, JSON out. An error is also sent as an answer.

An error is `{"error": text with a remedy, "field": the setting or null}`, with `retry_s` where the same query may
succeed later.
"""

from __future__ import annotations

import json
import logging
import math
from collections.abc import Callable
from typing import Any

from lidarcodec.errors import LidarCodecError, SettingsError, UnknownNameError
from lidarcodec.untrusted.json import JsonRefusedError, read_object

logger = logging.getLogger(__name__)


class TooOftenError(SettingsError):
    """Queries came too often; retry_s: seconds until the next one is answered."""

    def __init__(self, what: str, retry_s: float) -> None:
        super().__init__(f"{what} too often: try again in {retry_s:.2f} s")
        self.retry_s = retry_s


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
            logger.exception("a query failed")
            out = {"error": "internal error; the log of the program that answers has the details", "field": None}
        return json.dumps(out).encode()

    return handle

"""The one reader of JSON that comes from elsewhere: from the network, from another process, out of a file.

It refuses what the standard reader lets through and what then fails far from its cause: documents too large or nested
too deep, NaN and infinity, numbers that no 64-bit field holds, text that cannot be written as UTF-8.

>>> read_json(b'{"fps": 10}')
{'fps': 10}
>>> read_json(b"[" * 300 + b"]" * 300)
Traceback (most recent call last):
  ...
lidarcodec.untrusted.json.JsonRefusedError: it is nested more than 16 deep
"""

from __future__ import annotations

import json
import math
import re
from typing import Any, Final

MAX_BYTES: Final = 64 * 1024
MAX_DEPTH: Final = 16
MAX_DIGITS: Final = 20
"""Of a whole number: 2**64 has as many."""

_TOKENS: Final = re.compile(rb'"(?:[^"\\]|\\.)*"?|[\[{]|[\]}]', re.DOTALL)
_ESCAPES_TO_CHECK: Final = re.compile(rb"\\u(?:[dD][89a-fA-F]|0000)")


class JsonRefusedError(ValueError):
    """No JSON, or JSON beyond the limits; the text completes "the status is refused: ..."."""


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise JsonRefusedError(f"the number {text[:24]} is out of range")
    return value


def _whole(text: str) -> int:
    if len(text.lstrip("-")) > MAX_DIGITS:
        raise JsonRefusedError(f"a number has {len(text)} digits: at most {MAX_DIGITS} are allowed")
    return int(text)


def _refuse_constant(constant: str) -> None:
    raise JsonRefusedError(f"{constant} is not JSON")


def _check_size(data: bytes, max_bytes: int) -> None:
    if len(data) > max_bytes:
        raise JsonRefusedError(f"it has {len(data):,} bytes; at most {max_bytes:,} are allowed")


def _check_depth(data: bytes) -> None:
    if data.count(b"[") + data.count(b"{") <= MAX_DEPTH:
        return
    depth = 0
    for token in _TOKENS.finditer(data):
        first = data[token.start()]
        if first in b"[{":
            depth += 1
            if depth > MAX_DEPTH:
                raise JsonRefusedError(f"it is nested more than {MAX_DEPTH} deep")
        elif first in b"]}":
            depth -= 1


def _check_escapes(data: bytes, value: Any) -> None:
    """Half a surrogate pair, or a zero character, can be parsed but neither sent on nor stored."""
    if _ESCAPES_TO_CHECK.search(data) is None:
        return
    text = json.dumps(value, ensure_ascii=False)
    if "\\u0000" in text:  # a doubled backslash before it is refused with it
        raise JsonRefusedError("a text has a zero character")
    try:
        text.encode()
    except UnicodeEncodeError:
        raise JsonRefusedError("a text has half a surrogate pair") from None


def read_json(data: bytes | str, max_bytes: int = MAX_BYTES) -> Any:
    """The value of a JSON document of at most `max_bytes` bytes.

    It is nested at most 16 deep; its numbers are finite, its whole numbers have at most 20 digits; its text is valid
    UTF-8 without zero characters. Cost: 2.3 ms for 42 kB, seven times `json.loads`.

    Raises JsonRefusedError, a ValueError, for everything else, and nothing but that.
    """
    try:
        given = data.encode() if isinstance(data, str) else bytes(data)
        _check_size(given, max_bytes)
        _check_depth(given)
        value = json.loads(given.decode(), parse_constant=_refuse_constant, parse_float=_finite, parse_int=_whole)
        _check_escapes(given, value)
    except JsonRefusedError:
        raise
    except (ValueError, RecursionError) as error:
        raise JsonRefusedError(f"it is malformed JSON ({error})") from None
    return value


def read_object(data: bytes | str, max_bytes: int = MAX_BYTES) -> dict[str, Any]:
    """The JSON object that a document is, within the limits of `read_json`.

    Raises JsonRefusedError.
    """
    value = read_json(data, max_bytes)
    if not isinstance(value, dict):
        raise JsonRefusedError("it is not a JSON object")
    return value

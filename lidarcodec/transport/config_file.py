"""Checks a Zenoh configuration file before Zenoh reads it.

Zenoh's own reader ends the process, without an error, if values are nested some ten thousand deep.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final

from lidarcodec.budgets import FileTooLargeError, read_file
from lidarcodec.errors import TransportError

MAX_DEPTH: Final = 32
"""Deepest nesting. Access control of `lidarcodec certs` needs six levels."""
_TOKENS: Final = re.compile(
    rb'"(?:[^"\\]|\\.)*"?|' rb"'(?:[^'\\]|\\.)*'?|" rb"//[^\n]*|/\*.*?(?:\*/|\Z)|[\[{\]}]", re.DOTALL
)
"""Texts, comments, and brackets outside of them. An unclosed one extends to the end, so each byte is matched once."""


def check_config_file(path: Path) -> None:
    """Raises TransportError for a file that cannot be read, is larger than 1 MiB, or is nested more than 32 deep."""
    try:
        data, depth = read_file(path, "zenoh"), 0
    except OSError as error:
        raise TransportError(f"cannot read the Zenoh configuration {path}: {error.strerror or error}") from None
    except FileTooLargeError as error:
        raise TransportError(f"{path} is not a Zenoh configuration: {error}") from None
    for token in _TOKENS.finditer(data):
        first = data[token.start()]
        depth += (first in b"[{") - (first in b"]}")
        if depth > MAX_DEPTH:
            raise TransportError(f"{path} is not a Zenoh configuration: it is nested more than {MAX_DEPTH} deep")

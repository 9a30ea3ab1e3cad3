"""Replaces characters that a database cannot store in the data of clients.

>>> storable({"co\\ud800dec": ["a\\x00b", 1.5, None]})
{'co\\ufffddec': ['a\\ufffdb', 1.5, None]}
"""

from __future__ import annotations

import re
from typing import Any, Final

_NOT: Final = re.compile("[\x00\ud800-\udfff]")


def storable(value: Any) -> Any:
    """The same value, with U+FFFD instead of NUL and lone surrogates in its texts and names."""
    if isinstance(value, str):
        return _NOT.sub("\ufffd", value)
    if isinstance(value, dict):
        return {storable(name): storable(one) for name, one in value.items()}
    if isinstance(value, list | tuple):
        return [storable(one) for one in value]
    return value

"""What a command prints at its end: text for people, or with `--json` one JSON value with the same facts.

A command gets `--json` by the parameter `as_json: AsJson = False`, and its schema by `@prints(...)`:

>>> from typing import TypedDict
>>> class Counted(TypedDict):
...     frames: int
>>> @prints(Counted)
... def count(as_json: bool = False) -> None:
...     tell({"frames": 3}, "3 frames", as_json)
>>> count(), count(as_json=True), schema_of(count) is Counted
3 frames
{
  "frames": 3
}
(None, None, True)
"""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, TypeVar

from lidarcodec.untrusted.text import lines_printable

Command = TypeVar("Command", bound=Callable[..., None])

SCHEMA: Final = "prints_json_of"
"""Attribute of a command's function that holds its schema."""


def prints(schema: Any) -> Callable[[Command], Command]:
    """Notes the type of what a command prints with `--json`: a TypedDict, a list of one, or a union of several."""

    def noted(command: Command) -> Command:
        setattr(command, SCHEMA, schema)
        return command

    return noted


def schema_of(command: Any) -> Any:
    """The type that `prints` noted; None if there is none."""
    return getattr(command, SCHEMA, None)


def tell(result: Mapping[str, Any] | Sequence[Any], text: str, as_json: bool) -> None:
    """Print a result: as JSON, otherwise the text. The result has only values that JSON can hold; names and texts from
    elsewhere steer no terminal."""
    print(json.dumps(result, indent=2) if as_json else lines_printable(text))


def terminal_width() -> int | None:
    """Columns of the terminal that standard output is; None if it is none."""
    return shutil.get_terminal_size().columns if sys.stdout.isatty() else None

"""Docstrings of the package as Markdown: runs of `name: what it is` become lists. A griffe extension of mkdocs.yml."""

from __future__ import annotations

import re
from typing import Any

import griffe

FIELD = re.compile(r"^[a-z]\w*(, [a-z]\w*)*:\s+(?=\S)")


def as_markdown(text: str) -> str:
    """The docstring with each field as an item of a list.

    >>> print(as_markdown("A frame.\\n\\nindex:  counts\\n        from 0\\npose:   where\\nRaises nothing."))
    A frame.
    <BLANKLINE>
    - `index`: counts
      from 0
    - `pose`: where
    <BLANKLINE>
    Raises nothing.
    """
    out: list[str] = []
    listed = False
    for line in text.splitlines():
        field = FIELD.match(line)
        if field:
            if not listed and out and out[-1]:
                out.append("")
            out += [f"- `{name}`: {rest}" for name, rest in _fields(line)]
            listed = True
        elif listed and line.startswith("  "):
            out.append("  " + line.strip())
        else:
            if listed and line:
                out.append("")
            listed = False
            out.append(line)
    return "\n".join(out)


def _fields(line: str) -> list[tuple[str, str]]:
    """Name and text of each field of a line; two may share one, parted by a semicolon and two spaces."""
    found = []
    for part in re.split(r";  (?=\w+: )", line):
        name, _, rest = part.partition(":")
        found.append((name.strip().replace(", ", "`, `"), rest.strip()))
    return found


class Docstrings(griffe.Extension):
    """Rewrites every docstring before it is rendered."""

    def on_instance(self, *, obj: griffe.Object | griffe.Alias, **_: Any) -> None:
        """Rewrite the docstring of one object."""
        if not obj.is_alias and obj.docstring:
            obj.docstring.value = as_markdown(obj.docstring.value)

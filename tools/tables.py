"""Tables in the documents that repeat tables of the code: `make tables` writes them.

Each stands between `<!-- table: NAME -->` and `<!-- end of table -->`. `tests/test_docs.py` compares them with the
code.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Final

from lidarcodec.codecs import table as codecs
from lidarcodec.settings import StreamSettings
from tools import command_tables

DOCS: Final = Path(__file__).resolve().parent.parent / "docs"
PLACE: Final = re.compile(r"(<!-- table: ([a-z ]+) -->\n).*?(<!-- end of table -->)", re.DOTALL)
PRIVATE: Final = 60_000
"""First number of codecs for private use."""


def codec_numbers() -> str:
    """Numbers of codecs in messages."""
    rows = [f"| {entry.number} | [{name}](codecs.md#{name}) |" for name, entry in codecs.entries().items()]
    return "\n".join(["| number | codec |", "|---|---|", *rows, f"| {PRIVATE} and up | private use |"])


def settings() -> str:
    """Settings that all codecs have in common, with what their first sentence says."""
    rows = ["| setting | default | |", "|---|---|---|"]
    for name, about in StreamSettings.model_json_schema()["properties"].items():
        default = json.dumps(about.get("default", {})).strip('"')
        words = " ".join(about["description"].split())
        first = re.match(r".*?[^.]\.(?= [A-Z`]|$)", words)
        rows.append(f"| [`{name}`](settings.md#{name}) | `{default}` | {first[0] if first else words} |")
    return "\n".join(rows)


TABLES: Final[dict[str, Callable[[], str]]] = {
    "codec numbers": codec_numbers,
    "settings": settings,
    "exit codes": command_tables.exit_codes,
    "variables": command_tables.variables,
    "further variables": command_tables.further_variables,
    "json of commands": command_tables.json_of_commands,
}


def written(text: str) -> str:
    """A document with its tables as the code has them."""
    return PLACE.sub(lambda place: f"{place[1]}\n{TABLES[place[2]]()}\n\n{place[3]}", text)


if __name__ == "__main__":
    for page in sorted(DOCS.rglob("*.md")):
        before = page.read_text()
        if (after := written(before)) != before:
            page.write_text(after)
            print(f"{page.name}: written")

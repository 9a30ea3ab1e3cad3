"""Every n of every row and kind: a table, and exit code 1 if anything was wrong.

python -m tests.failing [ROW ...] [--kind disk|core|large] [--at-most N] [--write docs/robustness.md]
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from tests.failing import shim
from tests.failing.rows import NETWORKS, STREAMS, rows
from tests.failing.running import swept

BEGIN, END = "<!-- failures: begin -->\n", "<!-- failures: end -->\n"
HEAD = (
    "| what | what fails | how often | calls | tried | went well all the same | said so | against a rule |\n"
    "|---|---|---|---:|---:|---:|---:|---:|\n"
)
NOT_LARGE = ("stream of pcodec", "stream of jxl")
"""Libraries in Rust, and libjxl, end the process when large memory is refused."""


def todo(names: list[str], kinds: list[shim.Kind]) -> Iterator[tuple[str, shim.Kind]]:
    """Rows and kinds that go together."""
    for name in names:
        for kind in kinds:
            if (name in (*STREAMS, NETWORKS) and kind == shim.Kind.DISK) or (
                name in NOT_LARGE and kind == shim.Kind.LARGE
            ):
                continue
            yield name, kind


def line(found: dict[str, Any]) -> str:
    """A line of the table."""
    codes, often = found.get("codes", {}), "the n-th and all after it" if found.get("goes_on") else "the n-th"
    cells = [found["row"], found.get("kind", "?"), often, found.get("calls", "?"), found.get("tries", "?")]
    cells += [codes.get("0", 0), codes.get("1", 0), len(found["wrong"])]
    return f"| {' | '.join(map(str, cells))} |\n"


def written(page: str, lines: list[str]) -> str:
    """A page with its table replaced.

    Raises ValueError when the page has no place for it.
    """
    head, begin, rest = page.partition(BEGIN)
    _, end, tail = rest.partition(END)
    if not begin or not end:
        raise ValueError("the page has no place for the table")
    return f"{head}{begin}\n{HEAD}{''.join(lines)}\n{end}{tail}"


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m tests.failing", description=__doc__)
    parser.add_argument("rows", nargs="*", metavar="ROW")
    parser.add_argument("--kind", choices=[kind.name.lower() for kind in shim.Kind])
    parser.add_argument("--at-most", type=int, help="so many n at random instead of every one")
    parser.add_argument("--write", type=Path, metavar="PAGE")
    given = parser.parse_args()
    names = given.rows or [row.name for row in rows()]
    kinds = [shim.Kind[given.kind.upper()]] if given.kind else list(shim.Kind)
    lines: list[str] = []
    wrong: list[str] = []
    print(HEAD, end="")
    for name, kind in todo(names, kinds):
        for found in swept(name, kind, given.at_most):
            lines.append(line(found))
            print(lines[-1], end="", flush=True)
            wrong += [f"{name}, {kind.name.lower()}: {one}" for one in found["wrong"]]
    if given.write is not None:
        given.write.write_text(written(given.write.read_text(), lines))
    for one in wrong:
        print(one, file=sys.stderr)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())

"""Rooms stay small enough to be looked over, and arrows between files go one way: docs/architecture.md."""

from __future__ import annotations

import ast
import re
import subprocess
from collections import Counter
from collections.abc import Iterator
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from types import ModuleType

import pytest

from lidarcodec.codecs import table as codecs
from lidarcodec.reduction import table as reducers
from tests.conftest import ROOT

PARTS = ("lidarcodec", "server", "native", "clients")
SIDE_BY_SIDE = 25


def files_of(*parts: str) -> list[Path]:
    """Files that are in the repository, or will be."""
    listing = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "--", *parts]
    done = subprocess.run(listing, cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode:
        pytest.skip("needs a checkout and git, which knows what was built and what was written")
    return [Path(name) for name in done.stdout.splitlines() if (ROOT / name).is_file()]


def test_no_folder_has_more_files_side_by_side_than_a_reader_looks_over() -> None:
    beside = Counter(path.parent.as_posix() for path in files_of(*PARTS))
    crowded = {folder: count for folder, count in beside.items() if count > SIDE_BY_SIDE}
    assert crowded == {}


@cache
def modules() -> dict[str, Path]:
    """Every module of the package and of the server's, by its name."""
    found = {}
    for home, package in ((ROOT, "lidarcodec"), (ROOT / "server", "lidarcodec_server")):
        for path in (home / package).rglob("*.py"):
            name = ".".join(path.relative_to(home).with_suffix("").parts).removesuffix(".__init__")
            found[name] = path
    return found


def imports_of(node: ast.AST, known: dict[str, Path]) -> Iterator[str]:
    """Modules that a piece of code imports, at once or later; not what only types or a program's first lines need."""
    for inner in ast.iter_child_nodes(node):
        if isinstance(inner, ast.expr):
            continue
        if isinstance(inner, ast.If) and ast.unparse(inner.test) in ("TYPE_CHECKING", "__name__ == '__main__'"):
            continue
        if isinstance(inner, ast.ImportFrom) and inner.module:
            full = (f"{inner.module}.{alias.name}" for alias in inner.names)
            yield from (name if name in known else inner.module for name in full)
        yield from imports_of(inner, known)


@cache
def imports_in(path: Path) -> set[str]:
    """Modules that a file imports."""
    return set(imports_of(ast.parse(path.read_text()), modules())) & modules().keys()


def test_no_imports_go_round_in_a_circle() -> None:
    """Not even those inside functions: they would only hide it."""
    arrows = {name: imports_in(path) - {name} for name, path in modules().items()}
    try:
        TopologicalSorter(arrows).prepare()
    except CycleError as error:
        raise AssertionError(f"a circle: {' -> '.join(error.args[1])}") from None


def reached_from(name: str, known: dict[str, Path]) -> set[str]:
    """Every module that one imports, at once or later, by itself or by others."""
    found: set[str] = set()
    waiting = [name]
    while waiting:
        one = waiting.pop()
        fresh = imports_in(known[one]) - found - {name}
        found |= fresh
        waiting += fresh
    return found


@pytest.mark.parametrize("table", [codecs, reducers], ids=["codecs", "reducers"])
def test_who_stands_in_a_table_knows_no_other_and_not_the_table(table: ModuleType) -> None:
    known, members = modules(), {entry.module for entry in table.entries().values()}
    for member in members:
        assert reached_from(member, known) & (members | {table.__name__}) == set(), member


BELOW = {
    "base": "",
    "bits": "base",
    "layers": "mask bits base",
    "motion": "base",
    "mask": "motion bits base",
    "planes": "mask motion bits base",
    "plane_motion": "motion base",
    "images": "plane_motion bits base",
    "clouds": "base",
    "maps": "bits base",
    "network": "bits base",
    "predictive": "network mask bits base",
    "ranges": "base",
    "pco": "ranges base",
    "sensors": "base",
    "session": "sensors clouds images pco ranges predictive planes network mask motion bits base",
    "reduction": "motion base",
    "packets": "base",
    "simulator": "base",
    "segments": "base",
}
"""Rooms of the native core, and those that they may include."""


def test_the_rooms_of_the_native_core_include_only_what_is_below_them() -> None:
    core = ROOT / "native" / "src"
    assert {path.name for path in core.iterdir()} == BELOW.keys()
    wrong = []
    for path in core.rglob("*.[ch]pp"):
        room = path.relative_to(core).parts[0]
        for included in re.findall(r'^#include "(.*)"', path.read_text(), flags=re.MULTILINE):
            if included.split("/")[0] not in (room, *BELOW[room].split()):
                wrong.append(f"{path.relative_to(core)} includes {included}")
    assert wrong == []

"""docs/contributing.md, done as it says: in a copy of the sources, with the tests that it names, seen by the page."""

from __future__ import annotations

import json
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from lidarcodec.codecs import table as codecs
from lidarcodec.reduction import table as reducers
from lidarcodec.settings import StreamSettings
from tests.conftest import ROOT

PAGE = (ROOT / "docs" / "contributing.md").read_text()
BLOCK = re.compile(r'^```(?P<kind>\w+)(?: title="(?P<path>[^"]+)")?\n(?P<text>.*?)^```$', re.DOTALL | re.MULTILINE)
CHAPTERS = {
    text.partition("\n")[0]: text.partition("\n")[2]
    for text in re.split(r"^## (?=An? )", PAGE, flags=re.MULTILINE)[1:]
}  # fmt: skip
COPIED = ("lidarcodec", "server", "tests", "benchmarks", "docs", "tools", "research", "clients", "native")
FILES = (".clang-format", "pyproject.toml", "README.md", "CHANGELOG.md", "SECURITY.md", "Makefile", "mkdocs.yml")
LEFT_OUT = shutil.ignore_patterns("node_modules", "history", "*.jpg", "*.png")
HERE = """
import os, runpy, sys
sys.meta_path[:] = [one for one in sys.meta_path if getattr(one, "__module__", "").startswith("_frozen_importlib")]
sys.path[:0] = [os.getcwd(), os.path.join(os.getcwd(), "server")]
sys.argv[:] = sys.argv[1:]
"""
"""Begins a program in the copy: an installed package that is edited in place would else come first."""
FORM = """
import asyncio, httpx, json
from lidarcodec.transport.memory import MemoryNetwork
from lidarcodec_server.app import create_app
from lidarcodec_server.config import ServerConfig

async def ask():
    app = create_app(ServerConfig(database_url="sqlite:///form.db"), transport=MemoryNetwork().transport())
    wire = httpx.ASGITransport(app, client=("127.0.0.1", 50_000))
    client = httpx.AsyncClient(transport=wire, base_url="http://127.0.0.1")
    async with app.router.lifespan_context(app), client:
        answers = [(await client.get(f"/api/v1/{of}")).json() for of in ("codecs", "settings")]
    print(json.dumps(answers))

asyncio.run(ask())
"""


def blocks(chapter: str) -> Iterator[tuple[str, str | None, str]]:
    """Kind, path and text of each block of a chapter."""
    for found in BLOCK.finditer(CHAPTERS[chapter]):
        yield found["kind"], found["path"], found["text"]


def run(folder: Path, code: str, *words: str) -> str:
    """What a program prints in the copy; the test fails if it does."""
    done = subprocess.run(
        [sys.executable, "-c", HERE + code, *words],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-4000:]
    return done.stdout


def passed_by(folder: Path, command: str) -> str:
    """What one of the page's commands of tests prints."""
    words = shlex.split(command)
    assert words[0] == "pytest"
    code = "runpy.run_module('pytest', run_name='__main__')"
    return run(folder, code, "pytest", "-q", "-p", "no:cacheprovider", "-p", "no:randomly", *words[1:])


def write(folder: Path, kind: str, path: str, text: str) -> None:
    """Write a block: a new file, lines after a line of a table, or a section at the end of a document."""
    target = folder / path
    if kind == "python":
        assert not target.exists()
        target.write_text(text)
    elif kind == "markdown":
        target.write_text(f"{target.read_text().rstrip()}\n\n{text}")
    else:
        before, *added = text.splitlines()
        assert before.startswith(" ")
        assert all(line.startswith("+") for line in added)
        whole = target.read_text()
        assert whole.count(f"\n{before[1:]}\n") == 1, f"{path} has no line: {before[1:]}"
        lines = "".join(f"{line[1:]}\n" for line in added)
        target.write_text(whole.replace(f"\n{before[1:]}\n", f"\n{before[1:]}\n{lines}"))


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The sources with everything added that the page adds, and its tables written."""
    folder = tmp_path_factory.mktemp("contributing")
    for name in COPIED:
        shutil.copytree(ROOT / name, folder / name, ignore=LEFT_OUT)
    for name in FILES:
        shutil.copy(ROOT / name, folder)
    for chapter in CHAPTERS:
        for kind, path, text in blocks(chapter):
            if path is not None:
                write(folder, kind, path, text)
            elif text.startswith("cp "):
                shutil.copy(*(folder / word for word in shlex.split(text)[1:]))
    for tool in ("tools/tables.py", "tools/sensor_tables.py"):
        run(folder, "runpy.run_path(sys.argv[0], run_name='__main__')", tool)
    return folder


@pytest.mark.sweep
@pytest.mark.parametrize("chapter", CHAPTERS)
def test_what_a_chapter_adds_passes_the_tests_that_it_names(chapter: str, copy: Path) -> None:
    commands = [text for kind, _, text in blocks(chapter) if kind == "sh" and not text.startswith("cp ")]
    assert commands
    for command in commands:
        assert " passed" in passed_by(copy, command)


def test_tables_of_the_documents_and_who_imports_whom_hold_with_the_additions(copy: Path) -> None:
    assert "[bzip2](codecs.md#bzip2)" in (copy / "docs" / "wire-format.md").read_text()
    assert "`comment`" in (copy / "docs" / "python-api.md").read_text()
    files = "tests/test_rooms.py tests/codecs/test_rate_knob.py tests/ratecontrol/test_curve.py"
    command = f"pytest {files} -k 'table or knob or bzip2'"
    assert " passed" in passed_by(copy, command)


@pytest.mark.sweep
def test_the_form_of_the_page_shows_codec_and_settings(copy: Path) -> None:
    """It is made of these two answers alone (clients/web/src/model/schema.ts)."""
    offered, common = json.loads(run(copy, FORM))
    added = {one["name"]: one for one in offered}["bzip2"]
    block = added["settings_schema"]["properties"]["block"]
    assert (block["default"], block["minimum"], block["maximum"]) == (9, 1, 9)
    assert block["description"] == "Size of the blocks of bzip2, in 100 kB."
    fields = common["properties"]
    assert "bzip2" in fields["codec"]["enum"]
    assert "nearest" in fields["reduction"]["examples"]
    assert fields["comment"]["more"] is True
    assert "comment on the stream" in fields["comment"]["description"]


def test_nothing_of_it_is_in_the_sources() -> None:
    assert "bzip2" not in codecs.names()
    assert "nearest" not in reducers.names()
    assert "comment" not in StreamSettings.model_fields

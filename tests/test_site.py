"""What a reader loses if these fail: a page that no menu of the site has, or a link of it that leads nowhere."""

from __future__ import annotations

import doctest
import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

import lidarcodec
from tests.conftest import ROOT

DOCS = ROOT / "docs"
SITE = yaml.safe_load((ROOT / "mkdocs.yml").read_text())
NOTEBOOKS = sorted((DOCS / "notebooks").glob("*.ipynb"))
REPOSITORY = "https://example.org/repository"


def loaded(name):
    """A module of tools/site, which is no package."""
    path = ROOT / "tools" / "site" / f"{name}.py"
    found = importlib.util.module_from_spec(importlib.util.spec_from_file_location(f"site_{name}", path))
    found.__spec__.loader.exec_module(found)
    return found


def pages(entry):
    """Every file that a part of the menu names."""
    if isinstance(entry, str):
        return [entry]
    return [page for one in (entry.values() if isinstance(entry, dict) else entry) for page in pages(one)]


def test_the_menu_names_every_page_once():
    named = pages(SITE["nav"])
    made = ["python-reference.md", *(f"notebooks/{path.stem}.md" for path in NOTEBOOKS)]  # by the hook
    written = [page for page in named if page not in made]
    assert sorted(written) == sorted(path.relative_to(DOCS).as_posix() for path in DOCS.rglob("*.md"))
    assert len(named) == len(set(named)) == len(written) + len(made)


def test_the_index_names_every_page_but_those_of_an_index_of_their_own():
    text = (DOCS / "index.md").read_text()
    for path in [*DOCS.rglob("*.md"), *NOTEBOOKS]:
        name = path.relative_to(DOCS).as_posix()
        assert name == "index.md" or name.startswith("decisions/0") or f"]({name})" in text, name


def test_links_that_leave_docs_lead_to_the_repository(caplog):
    hooks = loaded("hooks")
    out = hooks.links_out(
        "[a](../README.md#use) [b](../clients/python) [c](live.md#keys) [d](https://example.org/x) "
        "[e](../no.md) [f](#here)",
        DOCS / "index.md",
        REPOSITORY,
    )
    assert out == (
        f"[a]({REPOSITORY}/blob/main/README.md#use) [b]({REPOSITORY}/tree/main/clients/python) [c](live.md#keys) "
        "[d](https://example.org/x) [e](../no.md) [f](#here)"
    )
    assert [record.getMessage() for record in caplog.records] == ["index.md links ../no.md, which does not exist"]
    assert hooks.links_out("[a](../../Makefile)", DOCS / "decisions" / "README.md", REPOSITORY) == (
        f"[a]({REPOSITORY}/blob/main/Makefile)"
    )


def test_the_reference_has_every_public_name():
    text = loaded("hooks").reference()
    told = re.findall(r"^::: lidarcodec\.(\w+)$", text, flags=re.MULTILINE)
    assert sorted([*told, "LidarCodecError", "__version__"]) == sorted(lidarcodec.__all__)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_page_of_a_notebook_has_its_pictures_and_its_links_lead_somewhere(path):
    page, pictures = loaded("notebooks").page_of(path)
    assert page.startswith("# ")
    assert set(re.findall(r"!\[[^]]*\]\((.*?)\)", page)) == set(pictures)
    assert pictures
    assert all(picture.startswith(b"\x89PNG") for picture in pictures.values())
    for link in re.findall(r"(?<!!)\[[^]]*\]\(([^)#:]+)(?:#[^)]*)?\)", re.sub(r"(?s)```.*?```", "", page)):
        if not link.endswith(".png"):
            assert (path.parent / link).is_file(), link


def test_fields_of_docstrings_become_lists():
    pytest.importorskip("griffe", reason="needs the packages of requirements/site.txt: `make site` installs them")
    assert doctest.testmod(loaded("docstrings")).failed == 0


@pytest.mark.sweep
@pytest.mark.timeout(600)
def test_the_site_builds_without_a_warning(tmp_path):
    pytest.importorskip("mkdocs", reason="needs the packages of requirements/site.txt: `make site` installs them")
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--quiet", "--strict", "--site-dir", tmp_path],
        cwd=ROOT,
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
        check=False,
        timeout=580,
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    assert "packets_of" in Path(tmp_path / "python-reference" / "index.html").read_text()

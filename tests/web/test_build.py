"""The committed page is what its sources give; without node nobody would notice that it is not.

The page's own checks are run by `make test`, when one of its files has changed.
"""

from __future__ import annotations

import json
import re
from hashlib import sha256
from pathlib import Path

from tests.conftest import ROOT

WEB = ROOT / "clients" / "web"
BUILT = ROOT / "server" / "lidarcodec_server" / "web"


def hashes(paths: list[Path]) -> dict[str, str]:
    return {path.relative_to(ROOT).as_posix(): sha256(path.read_bytes()).hexdigest() for path in sorted(paths)}


def sources() -> list[Path]:
    listed = [(WEB / name).resolve() for name in json.loads((WEB / "package.json").read_text())["sources"]]
    found = [path for one in listed for path in ([one] if one.is_file() else one.rglob("*"))]
    return [path for path in found if path.is_file() and not re.search(r"\.test\.tsx?$", path.name)]


def test_the_committed_page_was_built_from_these_sources():
    told = json.loads((BUILT / "sources.json").read_text())
    assert told["sources"] == hashes(sources()), "make web, and commit server/lidarcodec_server/web"
    built = [path for path in BUILT.rglob("*") if path.is_file() and path.name != "sources.json"]
    assert told["built"] == hashes(built), "the built page was changed by hand: make web"


def test_the_page_is_small_enough_to_be_committed():
    assert sum(path.stat().st_size for path in BUILT.rglob("*") if path.is_file()) < 1_500_000


def test_nothing_is_loaded_from_elsewhere():
    for path in (*BUILT.glob("*.html"), *BUILT.rglob("*.css")):
        assert not re.search(r"(?:src|href)=\"?https?:|url\([\"']?https?:|@import", path.read_text()), path


def test_the_lock_file_names_no_registry():
    lock = (WEB / "package-lock.json").read_text()
    assert '"resolved"' not in lock

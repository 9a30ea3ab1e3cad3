"""What a user loses if these fail: packages, actions or images that are others than those that were tested."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys

import pytest
import yaml

from tests.conftest import ROOT
from tools import lock, sbom

WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.y*ml"))
UNITS = sorted((ROOT / "packaging").glob("*.service"))


def test_the_locks_agree_with_the_project_and_the_constraints():
    assert lock.problems() == []


def test_a_lock_that_disagrees_is_found(tmp_path, monkeypatch):
    shutil.copytree(ROOT / "requirements", tmp_path / "requirements")
    for name in ("constraints.txt", "pyproject.toml"):
        shutil.copy(ROOT / name, tmp_path)
    monkeypatch.setattr(lock, "ROOT", tmp_path)
    path = tmp_path / "requirements" / "base.txt"
    text = re.sub(r"(?m)^numpy==\S+", "numpy==1.0", path.read_text())
    text = re.sub(r"(?ms)^lz4==.*?(?=^mcap)", "", text)
    text = re.sub(r"(?ms)^(av==\S+) .*?(?=^[a-z]+-zenoh)", r"\1\n", text)
    path.write_text(text + "--index-url https://packages.example/simple\n")
    found = " ".join(lock.problems())
    assert "base: numpy==1.0, constraints.txt has" in found
    assert "base: lz4 is missing" in found
    assert re.search(r"base: av==\S+ has no hash", found)
    assert "base: an address" in found


def test_all_that_make_and_the_images_download_has_a_hash():
    text = (ROOT / "Makefile").read_text()
    calls = [line for line in text.splitlines() if "$(PIP) " in line and line.startswith("\t")]
    assert [
        line for line in calls if "--no-deps" not in line and "$(EDITABLE)" not in line and "$(TORCH)" not in line
    ] == []
    assert "EDITABLE := --no-deps " in text
    assert text.count("$(LOCKED)/") == 5


def test_the_bill_of_materials_is_current_and_whole():
    assert sbom.SBOM.read_text() == sbom.bill(), "run it again: python tools/sbom.py"
    found = json.loads(sbom.bill())
    assert (found["bomFormat"], found["specVersion"]) == ("CycloneDX", "1.6")
    names = {component["name"] for component in found["components"]}
    assert {"numpy", "eclipse-zenoh", "fastapi", "psycopg", "preact", "zstddec"} <= names
    assert not {"pytest", "vite", "mypy"} & names
    for component in found["components"]:
        assert component["purl"].startswith(("pkg:pypi/", "pkg:npm/"))


def test_workflows_name_actions_by_commit_and_may_only_read():
    assert WORKFLOWS
    for path in WORKFLOWS:
        text = path.read_text()
        assert yaml.safe_load(text)["permissions"] == {"contents": "read"}
        for used in re.findall(r"uses: (.*)", text):
            assert re.fullmatch(r"[\w./-]+@[0-9a-f]{40} # v\d+\.\d+\.\d+", used), used
        assert text.count("actions/checkout@") == text.count("persist-credentials: false")
        for line in re.findall(r".*pip install.*", text):
            assert "--require-hashes" in line


def test_images_of_others_are_named_by_digest():
    named = {}
    for service in yaml.safe_load((ROOT / "docker" / "compose.yaml").read_text())["services"].values():
        image = service["image"]
        if not image.startswith("lidarcodec-"):
            named[image.partition(":")[0]] = "@sha256:" in image
    without = [image for image, pinned in named.items() if not pinned]
    assert without == ["eclipse/zenoh"]  # SECURITY.md says so
    assert "`eclipse/zenoh`" in (ROOT / "SECURITY.md").read_text()


def test_locks_of_npm_have_hashes():
    for folder in ("web", "typescript"):
        packages = json.loads((ROOT / "clients" / folder / "package-lock.json").read_text())["packages"]
        assert [path for path, one in packages.items() if path and "integrity" not in one] == []


@pytest.mark.parametrize("unit", UNITS, ids=lambda unit: unit.stem)
def test_a_unit_gives_its_process_little(unit):
    lines = set(unit.read_text().splitlines())
    assert {
        "NoNewPrivileges=yes",
        "CapabilityBoundingSet=",
        "ProtectSystem=strict",
        "PrivateDevices=yes",
        "RestrictNamespaces=yes",
        "SystemCallFilter=@system-service",
        "SystemCallFilter=~@privileged",
        "MemoryDenyWriteExecute=yes",
    } <= lines
    assert any(line.startswith("MemoryMax=") for line in lines)


@pytest.mark.parametrize("unit", UNITS, ids=lambda unit: unit.stem)
def test_systemd_finds_a_unit_well_shut(unit):
    program = shutil.which("systemd-analyze")
    if program is None:
        pytest.skip("needs systemd-analyze")
    done = subprocess.run(
        [program, "security", "--offline=true", "--threshold=20", unit],
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    if "--offline" in done.stderr:
        pytest.skip("this systemd has no --offline")
    assert done.returncode == 0, done.stdout[-300:]


@pytest.mark.parametrize("tool", ["lock", "sbom"])
def test_the_tools_check_from_the_command_line(tool):
    subprocess.run([sys.executable, ROOT / "tools" / f"{tool}.py", "--check"], check=True, timeout=60)

"""The extension for Foxglove, built, and read with Foxglove's own packages: clouds are those of the package."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import zipfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from lidarcodec.interop.poses import quaternion_of
from lidarcodec.sources.recording import RecordingSource
from tests.command_line import run_here
from tests.commands.test_convert_messages import written
from tests.conftest import ROOT

CLIENT = ROOT / "clients" / "foxglove"
POINT = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "u1"), ("ring", "u1")])


@pytest.fixture(scope="module")
def built() -> Iterator[Path]:
    """A folder with the extension, its archive, and the tests in JavaScript."""
    if shutil.which("node") is None or not (CLIENT / "node_modules" / "esbuild").is_dir():
        pytest.skip("needs node, and `npm ci` in clients/foxglove once")
    out = CLIENT / "dist" / f"tests-{os.getpid()}"
    words = ["node", "tools/build.mjs", "--tests", "--out", str(out)]
    subprocess.run(words, cwd=CLIENT, check=True, capture_output=True, timeout=300)
    yield out
    shutil.rmtree(out)


def ran(built: Path, name: str, **variables: str) -> str:
    words = ["node", "--test", str(built / "test" / f"{name}.test.mjs")]
    done = subprocess.run(
        words, capture_output=True, text=True, check=False, timeout=300, env={**os.environ, **variables}
    )
    assert done.returncode == 0, done.stdout[-4000:]
    return done.stdout


@pytest.mark.parametrize(
    ("vectors", "least"),
    [("_coarse$|^zstd$|vlp16|xt32", 20), pytest.param("", 60, marks=pytest.mark.sweep)],
    ids=["some", "all"],
)
def test_it_agrees_with_the_vectors_and_survives_hostile_bytes(built: Path, vectors: str, least: int) -> None:
    done = ran(built, "converters", LIDARCODEC_VECTORS=vectors)
    assert int(re.search(r"^# pass (\d+)", done, re.M)[1]) >= least  # type: ignore[index]


def test_foxgloves_own_packages_read_a_bag_and_its_points_are_ours(built: Path, tmp_path: Path) -> None:
    recording = written(tmp_path / "recorded.mcap")
    bag, out = tmp_path / "drive.mcap", tmp_path / "out"
    out.mkdir()
    assert run_here("convert", recording, bag, "--as", "messages").returncode == 0
    ran(built, "bag", LIDARCODEC_BAG=str(bag), LIDARCODEC_OUT=str(out))
    with RecordingSource(recording) as source:
        frames = list(source.frames())
    assert len(list(out.glob("*.points"))) == len(frames)
    for number, frame in enumerate(frames):
        found, cloud = np.fromfile(out / f"{number}.points", POINT), frame.cloud()
        for name in ("intensity", "ring"):
            assert np.array_equal(found[name], cloud[name])
        for name in "xyz":
            np.testing.assert_allclose(found[name], cloud[name], atol=2e-4)
        pose = json.loads((out / f"{number}.json").read_text())["pose"]
        assert (pose is None) == (frame.pose is None)
        if frame.pose is not None:
            assert list(pose["translation"].values()) == frame.pose[:3, 3].tolist()
            assert list(pose["rotation"].values()) == pytest.approx(quaternion_of(frame.pose))


def test_the_archive_is_what_foxglove_installs(built: Path) -> None:
    (archive,) = built.glob("*.foxe")
    with zipfile.ZipFile(archive) as file:
        assert file.testzip() is None
        names = set(file.namelist())
        about = json.loads(file.read("package.json"))
    assert names == {"package.json", "README.md", "CHANGELOG.md", "LICENSE", "dist/extension.js"}
    assert archive.name == f"{about['publisher']}.{about['name']}-{about['version']}.foxe"
    assert about["main"] == "./dist/extension.js"
    assert archive.stat().st_size < 1_000_000


@pytest.mark.sweep
def test_its_types_fit_those_of_foxglove() -> None:
    compiler = CLIENT / "node_modules" / "typescript" / "bin" / "tsc"
    if shutil.which("node") is None or not compiler.is_file():
        pytest.skip("needs node, and `npm ci` in clients/foxglove once")
    done = subprocess.run(
        ["node", str(compiler), "--noEmit"], cwd=CLIENT, capture_output=True, text=True, check=False, timeout=300
    )
    assert done.returncode == 0, done.stdout


def test_it_has_the_version_of_the_package_and_its_lock_file_names_no_registry() -> None:
    version = re.search(r'^version = "(.+)"', (ROOT / "pyproject.toml").read_text(), re.M)
    assert version is not None
    assert json.loads((CLIENT / "package.json").read_text())["version"] == version[1]
    assert '"resolved"' not in (CLIENT / "package-lock.json").read_text()

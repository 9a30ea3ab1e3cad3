"""The plug-in for point_cloud_transport: its decoder, on the installed C library, and the files that ROS reads."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from lidarcodec import wire
from lidarcodec.errors import DecodeError
from lidarcodec.interop.compressed_cloud import FORMAT, TRANSPORT
from lidarcodec.interop.point_cloud2 import points_of
from lidarcodec.pipeline import StreamDecoder
from lidarcodec.sensors.clouds.message import read_message, values_at
from lidarcodec.sensors.clouds.points import payload_of
from tests.conftest import ROOT
from tests.vectors import cloud_vectors
from tests.vectors.make import split

PACKAGE = ROOT / "clients" / "ros2" / "lidarcodec_point_cloud_transport"


@pytest.fixture(scope="module")
def built(installed: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the build."""
    if shutil.which("cmake") is None:
        pytest.skip("needs cmake")
    out = tmp_path_factory.mktemp("decoder")
    configure = ["cmake", "-S", str(PACKAGE / "decoder"), "-B", str(out), f"-DCMAKE_PREFIX_PATH={installed}"]
    for words in (configure, ["cmake", "--build", str(out)]):
        subprocess.run(words, check=True, capture_output=True, timeout=300)
    return out


@pytest.mark.sweep  # it is compiled
def test_its_own_test_passes(built: Path) -> None:
    done = subprocess.run(
        ["ctest", "--output-on-failure"], cwd=built, capture_output=True, text=True, check=False, timeout=120
    )
    assert done.returncode == 0, done.stdout
    assert "100% tests passed" in done.stdout


@pytest.mark.sweep
@pytest.mark.parametrize("name", ["golden/v1_riddle_coarse", "vectors/zstd", "vectors/other_zstd_os1-128"])
def test_points_are_those_of_the_bridge(built: Path, tmp_path: Path, name: str) -> None:
    path = ROOT / "tests" / f"{name}.bin"
    words = [str(built / "test_decoder"), "--points", str(path), str(tmp_path)]
    done = subprocess.run(words, check=True, capture_output=True, text=True, timeout=120)
    decoder = StreamDecoder()
    for number, data in enumerate(split(path.read_bytes())):
        (frame,) = decoder.decode(wire.unpack(data))
        wanted = points_of(frame)
        names = [one for one in wanted.dtype.names or () if one != "time" or not frame.sensor.is_hdl64e]
        dtype = np.dtype([(one, wanted.dtype[one]) for one in names])
        assert done.stdout.splitlines()[number].split() == [*names, str(dtype.itemsize)]
        found = np.fromfile(tmp_path / f"{number}.points", dtype)
        assert len(found) == len(wanted)
        for one in names:
            np.testing.assert_allclose(found[one], wanted[one], rtol=1e-5, atol=1e-4, err_msg=one)


@pytest.mark.sweep
def test_point_clouds_of_drivers_keep_all_fields(built: Path, tmp_path: Path) -> None:
    path = cloud_vectors.FOLDER / "predictive.bin"
    words = [str(built / "test_decoder"), "--points", str(path), str(tmp_path)]
    done = subprocess.run(words, check=True, capture_output=True, text=True, timeout=120)
    decoder = StreamDecoder()
    for number, data in enumerate(split(path.read_bytes())):
        (frame,) = decoder.decode(wire.unpack(data))
        found = (tmp_path / f"{number}.points").read_bytes()
        try:
            message = read_message(payload_of(frame))
        except DecodeError:
            assert found == b""
            continue
        fields = message.head.fields
        size = sum(np.dtype(one.kind).itemsize * one.repeated for one in fields)
        assert done.stdout.splitlines()[number].split() == [*(one.name for one in fields), str(size)]
        dtype = np.dtype([(one.name, "<" + one.kind, (one.repeated,)) for one in fields])
        points = np.frombuffer(found, dtype)
        assert len(points) == message.head.points
        for one in fields:
            wanted = values_at(message.points, one.offset, message.head.dtype_of(one))
            assert wanted.tobytes() == points[one.name][:, 0].tobytes(), one.name


@pytest.mark.sweep
def test_other_codecs_are_refused_by_name(built: Path, tmp_path: Path) -> None:
    words = [str(built / "test_decoder"), "--points", str(ROOT / "tests/golden/v1_jxl_lossless.bin"), str(tmp_path)]
    done = subprocess.run(words, check=True, capture_output=True, text=True, timeout=120)
    assert "jxl" in done.stdout
    assert list(tmp_path.iterdir()) == []


def test_the_files_of_the_package_agree() -> None:
    about = ElementTree.parse(PACKAGE / "package.xml").getroot()
    assert about.findtext("name") == PACKAGE.name
    version = re.search(r'^version = "(.+)"', (ROOT / "pyproject.toml").read_text(), re.M)
    assert version is not None
    assert about.findtext("version") == version[1]
    (plugin,) = ElementTree.parse(PACKAGE / "plugins.xml").getroot()
    source = (PACKAGE / "src" / "subscriber.cpp").read_text() + (PACKAGE / "src" / "subscriber.hpp").read_text()
    assert plugin.get("name") == f"point_cloud_transport/{TRANSPORT}_sub"
    assert f"PLUGINLIB_EXPORT_CLASS({plugin.get('type')}, {plugin.get('base_class_type')})" in source
    assert f'return "{TRANSPORT}";' in source
    assert f'kFormat = "{FORMAT}"' in source
    built = (PACKAGE / "CMakeLists.txt").read_text()
    for one in about.findall("depend"):
        assert f"find_package({one.text} REQUIRED)" in built
    for launch in (PACKAGE / "launch").iterdir():
        compile(launch.read_text(), str(launch), "exec")

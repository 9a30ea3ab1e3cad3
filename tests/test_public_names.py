"""What a user would lose: names that the documentation promises, and a quick `import lidarcodec`."""

from __future__ import annotations

import subprocess
import sys

import pytest

import lidarcodec


def test_every_public_name_is_there_and_listed_once() -> None:
    assert sorted(lidarcodec.__all__) == sorted(set(lidarcodec.__all__))
    assert set(lidarcodec._HOME) | {"LidarCodecError", "__version__"} == set(lidarcodec.__all__)
    for name in lidarcodec.__all__:
        assert getattr(lidarcodec, name) is not None


def test_open_names_what_opens() -> None:
    with pytest.raises(AttributeError, match="'open': read_frames gives the frames"):
        lidarcodec.open("drive.pcap")


def test_import_brings_no_heavy_library() -> None:
    heavy = ("zenoh", "imagecodecs", "av", "typer", "mcap", "pydantic", "numpy")
    code = f"import sys, lidarcodec; print([m for m in {heavy} if m in sys.modules])"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert out.stdout.strip() == "[]"

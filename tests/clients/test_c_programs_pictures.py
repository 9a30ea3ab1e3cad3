"""The programs of clients/cpp with the decoders of pictures that are installed, against the package."""

from __future__ import annotations

import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lidarcodec import wire
from lidarcodec.message import SectionType
from lidarcodec.pipeline import StreamDecoder
from tests.clients.test_c_library import record
from tests.conftest import ROOT
from tests.vectors.make import split

NEEDS = {
    "jpeg": ("HAS_JPEG_OF_12_BITS:INTERNAL=1", "libjpeg-turbo 3"),
    "jpeg-layered": ("HAS_JPEG_OF_12_BITS:INTERNAL=1", "libjpeg-turbo 3"),
    "h264": ("FFMPEG_FOUND:INTERNAL=1", "FFmpeg: apt install libavcodec-dev"),
    "h264-log": ("FFMPEG_FOUND:INTERNAL=1", "FFmpeg: apt install libavcodec-dev"),
}
"""What the cache of CMake says where the programs were built with a decoder."""


@pytest.mark.parametrize("codec", NEEDS)
def test_a_recording_of_pictures_is_decoded(codec: str, programs: Path, tmp_path: Path) -> None:
    """All frames of all messages, and without a decoder a sentence that names the codec."""
    data = list(split((ROOT / f"tests/golden/v1_{codec}_default.bin").read_bytes()))
    recording, out = tmp_path / "stream.mcap", tmp_path / "points"
    record(recording, data, "none")
    words = [programs / "decode_recording", recording, out]
    ran = subprocess.run(words, capture_output=True, text=True, timeout=60, check=False)
    built, library = NEEDS[codec]
    if built not in (programs / "CMakeCache.txt").read_text():
        assert f"codec {codec} needs a decoder of pictures, and none was given" in ran.stderr
        pytest.skip(f"needs {library}")
    decoder = StreamDecoder()
    frames = [frame for one in data for frame in decoder.decode(wire.unpack(one))]
    assert ran.stdout.splitlines()[-1] == f"{len(frames)} frames, 0 messages refused", ran.stderr
    for number, frame in enumerate(frames):
        cloud = frame.cloud("first")
        points = np.fromfile(out / f"{number:06d}.bin", "<f4").reshape(-1, 4)
        wanted = np.stack([cloud[axis] for axis in "xyz"] + [cloud["intensity"] / np.float32(255)], 1)
        np.testing.assert_allclose(points, wanted, rtol=1e-5, atol=1e-4)


def test_damaged_pictures_are_refused_and_the_next_ones_decoded(programs: Path, tmp_path: Path) -> None:
    """No program ends, and the stream goes on with the next key message."""
    if NEEDS["h264"][0] not in (programs / "CMakeCache.txt").read_text():
        pytest.skip(f"needs {NEEDS['h264'][1]}")
    whole = [wire.unpack(one) for one in split((ROOT / "tests/golden/v1_h264_default.bin").read_bytes())]
    key, damaged = whole[0], []
    for place in range(12, 400, 7):
        sections = list(key.sections)
        at = next(at for at, one in enumerate(sections) if one.type == SectionType.RANGE)
        data = bytearray(sections[at].data)
        data[place % len(data)] ^= 16
        sections[at] = sections[at]._replace(data=bytes(data))
        damaged.append(wire.pack(replace(key, sections=tuple(sections))))
    recording = tmp_path / "stream.mcap"
    record(recording, [*damaged, *map(wire.pack, whole)], "none")
    ran = subprocess.run(
        [programs / "decode_recording", recording], capture_output=True, text=True, timeout=60, check=False
    )
    assert ran.returncode in (0, 1)
    assert len([line for line in ran.stdout.splitlines() if " frame " in line]) >= len(whole)

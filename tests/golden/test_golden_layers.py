"""Refinements, as this version wrote them, are read for ever.

`layers.bin` holds messages one after the other, a u32 with the size before each: of each case a base and its
refinements. The frames are computed here.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from lidarcodec import wire
from lidarcodec.layers import RefinedFrame, is_refinement, unpack
from lidarcodec.pipeline import StreamDecoder
from tests.contracts import frames
from tests.layers.bases import sent, turn

FILE = Path(__file__).parent / "layers.bin"
CASES: tuple[tuple[Any, dict[str, Any]], ...] = (
    (turn(), {}),
    (turn(), {"intensity": "off", "shape": "rounded"}),
    (turn(), {"max_error_m": 0.02, "base_error_m": 0.5}),
    (frames.three_to_one(8), {"codec": "pcodec", "intensity": "levels=8"}),
)


def written() -> bytes:
    """What the file holds."""
    out = bytearray()
    for frame, settings in CASES:
        given = sent(frame, **settings)
        for data in (wire.pack(given.message), *map(given.refinable.code, given.refinable.sectors)):
            out += len(data).to_bytes(4, "little") + data
    return bytes(out)


def messages() -> list[bytes]:
    """The messages in the file."""
    data, at, found = FILE.read_bytes(), 0, []
    while at < len(data):
        size = int.from_bytes(data[at : at + 4], "little")
        found.append(data[at + 4 : at + 4 + size])
        at += 4 + size
    return found


def test_refinements_of_this_version_give_the_same_frames() -> None:
    if os.environ.get("LIDARCODEC_GOLDEN") == "write" and not FILE.exists():
        FILE.write_bytes(written())
    found: list[RefinedFrame] = []
    for data in messages():
        if is_refinement(data):
            assert found[-1].add(unpack(data))
            continue
        message = wire.unpack(data)
        (base,) = StreamDecoder().decode(message)
        found.append(RefinedFrame(base, message))
    assert len(found) == len(CASES)
    for one, (frame, settings) in zip(found, CASES, strict=True):
        came, most = one.frame(), 10 if "max_error_m" in settings else 0
        assert one.whole
        assert np.abs(came.range.astype(int) - frame.range.astype(int)).max() <= most
        np.testing.assert_array_equal(came.intensity, frame.intensity)


def test_encoders_write_the_same_bytes() -> None:
    assert FILE.read_bytes() == written()

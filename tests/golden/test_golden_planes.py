"""Planes of other sensors, as this version wrote them, are read for ever: alone, quick, and frames that follow.

`planes.bin` holds coded frames one after the other, a u32 with the size before each. The frames are computed here.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import numpy.typing as npt

from lidarcodec.entropy.plane_coder import PlaneMemory, SensorView, Unsigned, decode_planes, encode_planes
from tests.entropy.driven import DRIVEN, Form, driven

FILE = Path(__file__).parent / "planes.bin"
SHIFT = np.array([0, 3, -2, 3, 0, 3], np.int32)
RUNS = (None, np.array([[70, 3], [30, 5]], np.uint32), np.array([[100, 0]], np.uint32), None)
STEPS = (1, 1, 5, 1)


FORMS = (
    Form("range", 19, "range"),
    Form("range2", 19, "second range"),
    Form("flags", 5),
    Form("intensity", 8),
    Form("intensity2", 8, of="range2"),
    Form("signal", 16),
    Form("near_ir", 16),
)


def frame(number: int) -> dict[str, Unsigned]:
    """(6, 100) planes of a wall with a gap and a post before it; `number` moves it."""
    row, x = np.indices((6, 100))
    noise = (row * 7919 + x * 104_729 + number * 15_485_863) % 1013
    ranges = 9000 + 40 * row - 30 * number + 11 * np.abs(x - 50) + noise % 7
    ranges = np.where(abs(x - 20 - number) < 3, 2500 + noise % 5, ranges)
    ranges = np.where((x > 70) & (x < 80) | (noise % 97 == 0), 0, ranges)
    bright = np.where(ranges > 0, 20 + x // 9 + noise % 3, 0)
    planes = {
        "range": ranges,
        "range2": np.where(noise % 31 == 1, ranges + 900 * (ranges > 0), ranges),
        "flags": np.where(noise % 211 == 3, 9, 0),
        "intensity": bright,
        "intensity2": bright + (noise % 61 == 2),
        "signal": bright * 300_000 // np.maximum(ranges, 500) + noise % 4,
        "near_ir": (300 + 2 * x + noise % 23) * 16,
    }
    return {name: plane.astype(np.uint32) for name, plane in planes.items()}


def stored() -> list[bytes]:
    """Coded frames: one alone, one quick, then a stream of four, and one of a sensor that drives."""
    memory, drive = PlaneMemory(), PlaneMemory()
    coded = [encode_planes(FORMS, frame(0), SHIFT, quick=quick) for quick in (False, True)]
    return (
        coded
        + [
            memory.encode(FORMS, frame(number), SHIFT, step, runs)
            for number, (runs, step) in enumerate(zip(RUNS, STEPS, strict=True))
        ]
        + [drive.encode(DRIVEN, *driven_frame(number)) for number in range(3)]
    )


def driven_frame(
    number: int,
) -> tuple[dict[str, Unsigned], npt.NDArray[np.int32], int, npt.NDArray[np.uint32], SensorView]:
    """Planes, shift, step, runs and view of a frame of the drive."""
    planes, view = driven(number)
    rows, columns = planes["range"].shape
    return planes, np.zeros(rows, np.int32), 1, np.array([[columns, 0]], np.uint32), view


def read() -> list[bytes]:
    """What the file holds."""
    data, found = FILE.read_bytes(), []
    while data:
        size = int.from_bytes(data[:4], "little")
        found.append(data[4 : 4 + size])
        data = data[4 + size :]
    return found


def in_steps(values: Unsigned, step: int) -> npt.NDArray[np.int64]:
    """Ranges as they come back: docs/wire-format.md, "Range steps"; none of these is below a step."""
    wide = values.astype(np.int64)
    return (wide + step // 2) // step * step if step > 1 else wide


def test_planes_of_this_version_are_read() -> None:
    if os.environ.get("LIDARCODEC_GOLDEN") == "write" and not FILE.exists():
        FILE.write_bytes(b"".join(len(one).to_bytes(4, "little") + one for one in stored()))
    alone, quick, *stream = read()
    stream, drive = stream[:4], stream[4:]
    memory = PlaneMemory()
    found = [decode_planes(one, 100, FORMS, SHIFT) for one in (alone, quick)]
    found += [memory.decode(one, 100, FORMS, SHIFT, step) for one, step in zip(stream, STEPS, strict=True)]
    sent = [frame(0), frame(0), *map(frame, range(4))]
    for came, planes, step in zip(found, sent, (1, 1, *STEPS), strict=True):
        for form in FORMS:
            wanted = planes[form.name] if form.role == "attribute" else in_steps(planes[form.name], step)
            np.testing.assert_array_equal(came[form.name], wanted)
    memory = PlaneMemory()
    for number, data in enumerate(drive):
        planes, shift, *_ = driven_frame(number)
        came = memory.decode(data, planes["range"].shape[1], DRIVEN, shift)
        for form in DRIVEN:
            np.testing.assert_array_equal(came[form.name], planes[form.name])

"""Frames of a sensor that drives, computed here: for tests of planes that follow each other."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from lidarcodec.entropy.plane_coder import SensorView, Unsigned


class Form(NamedTuple):
    """A plane, as the layouts of sensors say."""

    name: str
    bits: int
    role: str = "attribute"
    of: str = "range"


DRIVEN = (Form("range", 16, "range"), Form("signal", 16, "attribute"))
"""The planes of `driven`."""


def driven(number: int, rows: int = 8, columns: int = 120) -> tuple[dict[str, Unsigned], SensorView]:
    """A street with pillars along both sides, seen by a sensor that drives ahead: ranges in centimetres. The last frame
    turns a little more than once."""
    up = np.linspace(8, -16, rows)
    aside = 3.0 * (np.arange(rows) % 2)
    azimuth = (3000 + 37 * number + np.arange(columns) * (300 if number < 2 else 310)) % 36000
    beams = np.rint(np.stack((up, aside), axis=1) * ((1 << 20) / 360)).astype(np.int32)
    angle, slope = np.radians(azimuth * 0.01 + aside[:, None]), np.radians(up)[:, None]
    x, y, z = np.cos(slope) * np.cos(angle), np.cos(slope) * np.sin(angle), np.sin(slope) + 0 * angle
    at, far = 0.8 * number, 7 / np.maximum(np.abs(y), 1e-6)
    pillar = np.sin(2.5 * (far * x + at)) > 0.6
    walls = [(x, 14 - at), (-x, 9 + at), (np.abs(y), 7 - 1.5 * pillar), (-z, 1.8)]
    with np.errstate(divide="ignore"):
        ranges = np.min([np.where(along > 0.01, apart / along, 1e9) for along, apart in walls], axis=0)
    ranges = np.where(slope < 0.12, np.rint(ranges * 100), 0)
    noise = (np.arange(ranges.size).reshape(ranges.shape) * 7919 + number * 104_729) % 5
    planes = {"range": np.where(ranges > 0, ranges + noise, 0), "signal": 300 + 200 * pillar + noise}
    view = SensorView(beams, azimuth.astype(np.uint16), 100.0)
    return {name: image.astype(np.uint32) for name, image in planes.items()}, view

"""A toy scene: walls and a slanted ground with noise, as an ideal sensor sees them; enough to learn from in seconds."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from lidarcodec.frame import Frame
from lidarcodec.sensor_model import Calibration, SensorModel


def toy_ranges(seed: int, rows: int = 24, columns: int = 120) -> npt.NDArray[np.float64]:
    """(rows, columns) metres, 0 = no return: slanted surfaces with jumps between them, 8 mm of noise, holes."""
    rng = np.random.default_rng([seed, 77])
    edges = np.sort(rng.choice(np.arange(min(10, columns // 4), columns - 5), 5, replace=False))
    wall = np.digitize(np.arange(columns), edges)
    near, rise = rng.uniform(6, 25, 6), rng.uniform(-0.2, 0.2, 6)
    ranges = near[wall] + rise[wall] * (np.arange(columns) - np.concatenate([[0], edges])[wall])
    ground = 8.0 / (1 + 0.05 * np.arange(rows)) + 4
    ranges = ranges.clip(2, 40)[None, :] * np.ones((rows, 1))
    ranges[rows // 2 :] = np.minimum(ranges[rows // 2 :], ground[rows // 2 :, None])
    ranges += rng.normal(0, 0.008, ranges.shape)
    ranges[rng.random(ranges.shape) < 0.1] = 0
    return ranges


def toy_sensor() -> SensorModel:
    """A sensor of 64 beams whose lasers look to both sides, start above the centre and have corrections."""
    lasers = np.arange(64)
    distance = 1.0 + (lasers % 5) * 0.05
    return SensorModel(
        "HDL-64E S2",
        Calibration.from_values(
            {
                "rot_correction_rad": np.where(lasers % 2, 0.05, -0.05),
                "vert_correction_rad": np.linspace(0.03, -0.43, 64),
                "dist_correction_m": distance,
                "dist_correction_x_m": distance,
                "dist_correction_y_m": distance,
                "vert_offset_m": np.linspace(0.2, 0.1, 64),
                "horiz_offset_m": np.where(lasers % 2, 0.026, -0.026),
            }
        ),
    )


def toy_frame(ranges: npt.NDArray[np.uint16], first: int = 0) -> Frame:
    """A frame of these ranges (64, W), columns 0.18 degree apart from azimuth `first` on."""
    width = ranges.shape[1]
    azimuth = np.broadcast_to((first + 18 * np.arange(width)) % 36000, (2, width)).astype(np.uint16)
    return Frame(0, 0, ranges, np.zeros(ranges.shape, np.uint8), azimuth, np.ones((2, width), np.bool_), toy_sensor())

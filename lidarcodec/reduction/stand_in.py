"""A frame of any sensor as 64 rows of an HDL-64E would hold it, to find how the sensor moved.

Rows are those of the sensor, the lowest ones empty if it has fewer, or 64 of them if it has more. Beams begin in the
middle of the sensor, so points lie a few centimetres off. That moves with the sensor and does not disturb.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Final

import numpy as np
import numpy.typing as npt

from lidarcodec.frame import Frame
from lidarcodec.planes.beam_directions import STEPS_PER_TURN, BeamBook
from lidarcodec.sensor_model import Calibration, SensorModel
from lidarcodec.units import LASERS, RANGE_STEP_M

_BELOW: Final = 0.01
"""Angle between empty rows, radians."""
_NAME: Final = "stand-in"


class StandIn:
    """Makes the stand-in frames of a stream; beams are computed once for each sensor."""

    def __init__(self) -> None:
        self._book = BeamBook()

    def of(self, frame: Frame) -> Frame | None:
        """The stand-in frame, without packets; None if it is not known where beams look."""
        beams = self._book.of(frame)
        if beams is None:
            return None
        rows = _chosen_rows(len(beams))
        steps = np.rint(frame.range[rows] * (frame.sensor.range_step_m / RANGE_STEP_M))
        steps[(steps > np.iinfo(np.uint16).max) | ~frame.valid[rows]] = 0
        ranges = np.zeros((LASERS, frame.width), np.uint16)
        ranges[: len(rows)] = steps
        angles = np.array(beams[rows] * (2 * np.pi / STEPS_PER_TURN))
        sensor = _sensor(angles.tobytes())
        nothing = np.zeros(ranges.shape, np.uint8)
        fired = np.ones((2, frame.width), np.bool_)
        return Frame(frame.index, frame.stamp_ns, ranges, nothing, frame.azimuth, fired, sensor, pose=frame.pose)


def _chosen_rows(rows: int) -> npt.NDArray[np.intp]:
    """Of up to 64 rows all, of more 64 that lie evenly."""
    return np.arange(rows) if rows <= LASERS else np.linspace(0, rows - 1, LASERS).round().astype(np.intp)


@lru_cache(maxsize=8)
def _sensor(angles: bytes) -> SensorModel:
    """The sensor of beams: (N, 2) float64, up and clockwise aside, in radians."""
    up, aside = np.frombuffer(angles).reshape(-1, 2).T
    empty = LASERS - len(up)
    below = up.min() - _BELOW * np.arange(1, empty + 1)
    values: dict[str, npt.ArrayLike] = {
        "vert_correction_rad": np.append(up, below),
        "rot_correction_rad": np.append(-aside, np.zeros(empty)),
    }
    return SensorModel(_NAME, Calibration.from_values(values))

"""ScoreImage: a frame as the input image of the score network, with rows aligned by direction.

The lasers of one firing point up to 18 degrees apart, so each cell goes to the column of its laser's direction. A turn
has 2048 columns; a slab has a part of them, in steps of 16. If several returns belong to a pixel, the last one is in
the
image, and all of them get its scores. Six channels, (6, 64, C) float32, zeros without a return:

    0  log(1 + range) / 2 - 1         1  height / 4 + 1/4          2  intensity / 255
    3  1                              4  step to the next column   5  gradient to the next row, -1 down ... 1 up

The step is the change of the horizontal distance, divided by 0.1 m plus 1 % of it, within -2 to 2. The gradient is
dz / (|dz| + |d distance|): 0 on a road, 1 or -1 on a wall. Cost: 8 ms for a turn.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from lidarcodec.frame import Frame
from lidarcodec.sensor_model import SensorModel
from lidarcodec.units import AZIMUTH_TURN, LASERS, LASERS_PER_BLOCK

TURN_COLUMNS: Final = 2048
CHANNELS: Final = 6
PATCH: Final = (2, 4)
"""Rows and columns of a patch. The first layer reads whole patches; the output has their pixels as channels."""
MULTIPLE: Final = 16
"""Width of a patch times 4, for two halvings."""
_MARGIN: Final = 1200
"""Margin of a slab, 12 degrees, because lasers point beside the azimuth of their firing."""

Floats = npt.NDArray[np.float32]


class ScoreImage(NamedTuple):
    """features: (6, 64, C) float32; pixel: (N,) intp, index in a (64, C) image for each requested cell"""

    features: Floats
    pixel: npt.NDArray[np.intp]


class _Rows(NamedTuple):
    """Values for each ring, (64, 1) each."""

    half: npt.NDArray[np.intp]
    turned: npt.NDArray[np.int32]  # hundredths of a degree
    cosine: Floats
    sine: Floats
    further: Floats
    higher: Floats


@lru_cache(maxsize=4)
def _rows(sensor: SensorModel) -> _Rows:
    lasers = sensor.laser_of_ring

    def of(name: str) -> npt.NDArray[np.float64]:
        return sensor.calibration[name][lasers][:, None]

    vert, dist = of("vert_correction_rad"), of("dist_correction_m")
    cosine, sine = np.cos(vert), np.sin(vert)
    turned = np.rint(np.degrees(of("rot_correction_rad")) * 100).astype(np.int32)
    numbers = (cosine, sine, dist * cosine, dist * sine + of("vert_offset_m") * cosine)
    return _Rows((lasers >= LASERS_PER_BLOCK).astype(np.intp), turned, *(n.astype(np.float32) for n in numbers))


@lru_cache(maxsize=2)
def _logarithms(step_m: float) -> Floats:
    values: Floats = (np.log1p(np.arange(1 << 16) * step_m) / 2 - 1).astype(np.float32)
    return values


def score_image(frame: Frame, cells: npt.NDArray[Any] | None = None) -> ScoreImage:
    """The image of a frame's returns. cells: (N,) row * W + column of the requested returns; by default all valid ones
    in ascending order"""
    rows = _rows(frame.sensor)
    begin, columns = _sweep(frame)
    turn = (frame.azimuth[rows.half].astype(np.int32) - (rows.turned + begin)) % AZIMUTH_TURN
    column = np.minimum(turn * TURN_COLUMNS // AZIMUTH_TURN, columns - 1)
    places = np.flatnonzero(frame.valid) if cells is None else cells
    pixel = (column + np.arange(LASERS, dtype=np.int32)[:, None] * columns).ravel()[places].astype(np.intp)

    steps = frame.range
    metres = steps.astype(np.float32) * np.float32(frame.sensor.range_step_m)
    level, height = metres * rows.cosine + rows.further, metres * rows.sine + rows.higher
    image = np.zeros((CHANNELS, LASERS, columns), np.float32)
    far = np.zeros((LASERS, columns), np.float32)
    values: tuple[npt.NDArray[Any], ...] = (
        _logarithms(frame.sensor.range_step_m)[steps.ravel()[places]],
        height.ravel()[places],
        frame.intensity.ravel()[places] * np.float32(1 / 255),
        np.ones(len(places), np.float32),
    )
    for channel, value in enumerate(values):
        image[channel].reshape(-1)[pixel] = value
    far.reshape(-1)[pixel] = level.ravel()[places]
    _add_shape(image, far)
    return ScoreImage(image, pixel)


def _add_shape(image: Floats, far: Floats) -> None:
    """Add channels 4 and 5 from the horizontal distances and the heights, then scale the heights."""
    height, seen = image[1], image[3]
    step = np.roll(far, -1, axis=1) - far
    image[4] = np.clip(step / (np.float32(0.1) + np.float32(0.01) * far), -2, 2) * (seen * np.roll(seen, -1, axis=1))
    rise, run = height[:-1] - height[1:], np.abs(far[:-1] - far[1:])
    image[5, :-1] = rise / (np.abs(rise) + run + np.float32(0.01)) * (seen[:-1] * seen[1:])
    image[1] = np.clip(height * np.float32(0.25) + np.float32(0.25), -1, 4) * seen


def _sweep(frame: Frame) -> tuple[int, int]:
    """Azimuth of column 0, and number of columns."""
    if not frame.width:
        return 0, MULTIPLE
    first = frame.azimuth[0].astype(np.int64)
    swept = int((np.diff(first) % AZIMUTH_TURN).sum()) + 2 * _MARGIN
    if swept >= AZIMUTH_TURN:
        return 0, TURN_COLUMNS
    columns = -(-swept * TURN_COLUMNS // AZIMUTH_TURN)
    return int(first[0]) - _MARGIN, min(-(-columns // MULTIPLE) * MULTIPLE, TURN_COLUMNS)


def unpatched(patches: Floats) -> Floats:
    """(K, 64, C) from (K * 8, 32, C / 4): for each of the K values, the channels are the pixels of a patch, row by
    row.
    """
    rows, columns = PATCH
    channels, height, width = patches.shape
    values = patches.reshape(channels // (rows * columns), rows, columns, height, width)
    whole: Floats = values.transpose(0, 3, 1, 4, 2).reshape(-1, height * rows, width * columns)
    return whole

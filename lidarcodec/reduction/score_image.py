"""ScoreImage: a frame as the input image of the score network, with rows aligned by direction.

The lasers of one firing point up to 18 degrees apart, so each cell goes to the column of its laser's direction. A turn
of an HDL-64E has 2048 columns, of another sensor as many as it fires, rounded down to 16; a slab has a part of them. If
several returns belong to a pixel, the last one is in the image, and all of them get its scores. Rows are those of the
sensor, and empty ones below up to a multiple of 8. Six channels, (6, rows, C) float32, zeros without a return:

    0  log(1 + range) / 2 - 1         1  height / 4 + 1/4          2  intensity / 255
    3  1                              4  step to the next column   5  gradient to the next row, -1 down ... 1 up

The step is the change of the horizontal distance, divided by 0.1 m plus 1 % of it, within -2 to 2. The gradient is
dz / (|dz| + |d distance|): 0 on a road, 1 or -1 on a wall. So all channels but the intensity say how a surface lies,
whatever the number of rows and their angles. Cost: 8 ms for a turn.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from lidarcodec.frame import Frame
from lidarcodec.planes.beam_directions import STEPS_PER_TURN, BeamBook
from lidarcodec.reduction.spread import LENGTHS_PER_M, Returns, returns_of
from lidarcodec.sensor_model import SensorModel
from lidarcodec.units import AZIMUTH_TURN, LASERS, LASERS_PER_BLOCK

TURN_COLUMNS: Final = 2048
HEIGHT_SCALE: Final = 0.25
MOST_INTENSITY: Final = 255
"""Larger intensities, of sensors that send 16 bits, count as this."""
CHANNELS: Final = 6
PATCH: Final = (2, 4)
"""Rows and columns of a patch. The first layer reads whole patches; the output has their pixels as channels."""
MULTIPLE: Final = 16
"""Width of a patch times 4, for two halvings."""
ROW_MULTIPLE: Final = 8
"""Height of a patch times 4."""
_MARGIN: Final = 1200
"""Margin of a slab, 12 degrees, because lasers point beside the azimuth of their firing."""

Floats = npt.NDArray[np.float32]


class ScoreImage(NamedTuple):
    """features: (6, rows, C) float32; pixel: (N,) intp, index in a (rows, C) image for each return"""

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


class _Placed(NamedTuple):
    """Where N returns belong in an image, and what it shows of them, metres. pixel: (N,); the rest (N,) float32"""

    shape: tuple[int, int]
    pixel: npt.NDArray[np.intp]
    logarithm: Floats
    level: Floats
    height: Floats


def score_image(frame: Frame, returns: Returns | None = None, book: BeamBook | None = None) -> ScoreImage:
    """The image of a frame's returns. returns: as `returns_of` gives them, if the caller has them already; book: of a
    stream, which saves 15 ms a frame with another sensor than an HDL-64E"""
    returns = returns_of(frame) if returns is None else returns
    if frame.sensor.is_hdl64e:
        placed = _of_hdl64e(frame, returns)
    else:
        placed = _of_other(frame, returns, BeamBook() if book is None else book)
    image = np.zeros((CHANNELS, *placed.shape), np.float32)
    far = np.zeros(placed.shape, np.float32)
    intensity = frame.intensity.ravel()[returns.cells]
    values: tuple[npt.NDArray[Any], ...] = (
        placed.logarithm,
        placed.height,
        np.minimum(intensity, MOST_INTENSITY) * np.float32(1 / MOST_INTENSITY),
        np.ones(len(returns.cells), np.float32),
    )
    for channel, value in enumerate(values):
        image[channel].reshape(-1)[placed.pixel] = value
    far.reshape(-1)[placed.pixel] = placed.level
    _add_shape(image, far)
    return ScoreImage(image, placed.pixel)


def _of_hdl64e(frame: Frame, returns: Returns) -> _Placed:
    rows, cells = _rows(frame.sensor), returns.cells
    begin, columns = _sweep(frame, TURN_COLUMNS)
    turn = (frame.azimuth[rows.half].astype(np.int32) - (rows.turned + begin)) % AZIMUTH_TURN
    column = np.minimum(turn * TURN_COLUMNS // AZIMUTH_TURN, columns - 1)
    pixel = (column + np.arange(LASERS, dtype=np.int32)[:, None] * columns).ravel()[cells].astype(np.intp)
    metres = frame.range.astype(np.float32) * np.float32(frame.sensor.range_step_m)
    level, height = metres * rows.cosine + rows.further, metres * rows.sine + rows.higher
    logarithm = _logarithms(frame.sensor.range_step_m)[frame.range.ravel()[cells]]
    return _Placed((LASERS, columns), pixel, logarithm, level.ravel()[cells], height.ravel()[cells])


def _of_other(frame: Frame, returns: Returns, book: BeamBook) -> _Placed:
    rows = -(-frame.sensor.rows // ROW_MULTIPLE) * ROW_MULTIPLE
    beams = book.of(frame)
    if beams is None or not len(returns.cells):  # no column, or no layout
        nothing = np.zeros(0, np.float32)
        return _Placed((rows, MULTIPLE), np.zeros(0, np.intp), nothing, nothing, nothing)
    of_turn = _turn_columns(frame)
    begin, columns = _sweep(frame, of_turn)
    aside = np.rint(beams[:, 1] * (AZIMUTH_TURN / STEPS_PER_TURN)).astype(np.int32)
    row, place = np.divmod(returns.cells.astype(np.intp), frame.width)
    turn = (frame.azimuth[0].astype(np.int32)[place] + (aside[row] - begin)) % AZIMUTH_TURN
    pixel = row * columns + np.minimum(turn * of_turn // AZIMUTH_TURN, columns - 1)
    x, y, z = returns.xyz.T.astype(np.float32) * np.float32(1 / LENGTHS_PER_M)
    metres = frame.range.ravel()[returns.cells] * np.float32(frame.sensor.range_step_m)
    return _Placed((rows, columns), pixel, (np.log1p(metres) / 2 - 1).astype(np.float32), np.hypot(x, y), z)


def _turn_columns(frame: Frame) -> int:
    """Columns of an image of a whole turn of another sensor than an HDL-64E: with as few holes as columns allow."""
    swept = int((np.diff(frame.azimuth[0].astype(np.int64)) % AZIMUTH_TURN).sum())
    fired = (frame.width - 1) * AZIMUTH_TURN // max(swept, 1)
    return min(max(fired // MULTIPLE, 1) * MULTIPLE, TURN_COLUMNS)


def _add_shape(image: Floats, far: Floats) -> None:
    """Add channels 4 and 5 from the horizontal distances and the heights, then scale the heights."""
    height, seen = image[1], image[3]
    step = np.roll(far, -1, axis=1) - far
    image[4] = np.clip(step / (np.float32(0.1) + np.float32(0.01) * far), -2, 2) * (seen * np.roll(seen, -1, axis=1))
    rise, run = height[:-1] - height[1:], np.abs(far[:-1] - far[1:])
    image[5, :-1] = rise / (np.abs(rise) + run + np.float32(0.01)) * (seen[:-1] * seen[1:])
    image[1] = np.clip(height * np.float32(HEIGHT_SCALE) + np.float32(0.25), -1, 4) * seen


def _sweep(frame: Frame, of_turn: int) -> tuple[int, int]:
    """Azimuth of column 0, and number of columns. of_turn: columns of an image of a whole turn"""
    if not frame.width:
        return 0, MULTIPLE
    first = frame.azimuth[0].astype(np.int64)
    swept = int((np.diff(first) % AZIMUTH_TURN).sum()) + 2 * _MARGIN
    if swept >= AZIMUTH_TURN:
        return 0, of_turn
    columns = -(-swept * of_turn // AZIMUTH_TURN)
    return int(first[0]) - _MARGIN, min(-(-columns // MULTIPLE) * MULTIPLE, of_turn)


def unpatched(patches: Floats) -> Floats:
    """(K, rows, C) from (K * 8, rows / 2, C / 4): the channels of each of the K values are the pixels of
    a patch, row by row.
    """
    rows, columns = PATCH
    channels, height, width = patches.shape
    values = patches.reshape(channels // (rows * columns), rows, columns, height, width)
    whole: Floats = values.transpose(0, 3, 1, 4, 2).reshape(-1, height * rows, width * columns)
    return whole

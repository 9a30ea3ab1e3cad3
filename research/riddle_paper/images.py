"""The quantised range image that RIDDLE codes, with the direction of each beam.

Rows are lasers from the top down, columns directions: the canvas, on which the rows of an HDL-64E are moved so that
neighbours on paper look in neighbouring directions, as they do in the range images of the paper's sensor.

>>> image = PaperImage.plain(np.array([[5.0, 5.02, 0.0], [4.0, 0.0, 4.1]]), step=10)
>>> image.cells.tolist(), image.valid.sum()
([[250, 251, 0], [200, 0, 205]], np.int64(4))
>>> previous_valid(image.cells, image.valid).tolist()
[[0, 250, 251], [250, 200, 200]]
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from lidarcodec.errors import LidarCodecError
from lidarcodec.frame import Frame
from lidarcodec.ranges.image.canvas import Canvas, level_offsets, spacing_of
from lidarcodec.units import AZIMUTH_STEP_DEG, LASERS_PER_BLOCK, RANGE_STEP_M

Cells = npt.NDArray[np.int32]
Mask = npt.NDArray[np.bool_]
Angles = npt.NDArray[np.float32]

_PLAIN_AZIMUTH_RAD, _PLAIN_ELEVATION_RAD = 0.003, -0.007


@dataclass(frozen=True, eq=False)
class PaperImage:
    """A quantised range image of H rows and W columns.

    cells:     (H, W) int32, range in whole steps, 0 where nothing is valid
    valid:     (H, W) bool, where there is a return; known to a decoder before any range
    azimuth:   (H, W) float32, radians, growing to the right without a jump; elevation: (H, W) float32, radians
    step:      range steps of 2 mm in a cell
    """

    cells: Cells
    valid: Mask
    azimuth: Angles
    elevation: Angles
    step: int

    @property
    def step_m(self) -> float:
        """Metres in a cell."""
        return self.step * RANGE_STEP_M

    @classmethod
    def plain(cls, ranges_m: npt.NDArray[np.float64], step: int) -> PaperImage:
        """The image of an ideal sensor with even directions. ranges_m: (H, W) metres, 0 = no return."""
        rows, columns = ranges_m.shape
        valid = ranges_m > 0
        cells = np.where(valid, np.rint(ranges_m / (step * RANGE_STEP_M)), 0).astype(np.int32)
        azimuth = np.arange(columns, dtype=np.float32) * np.float32(_PLAIN_AZIMUTH_RAD)
        elevation = np.arange(rows, dtype=np.float32) * np.float32(_PLAIN_ELEVATION_RAD)
        shape = (rows, columns)
        return cls(
            cells, valid, np.broadcast_to(azimuth, shape), np.broadcast_to(elevation[:, None], shape), step
        )  # fmt: skip

    def with_cells(self, cells: Cells) -> PaperImage:
        """The same image with other ranges."""
        return replace(self, cells=cells)


def canvas_of(frame: Frame) -> Canvas:
    """Where the cells of a frame lie in its image. It follows from azimuths and calibration, which a decoder has."""
    return Canvas.of(frame.sensor, frame.valid, spacing_of(frame.azimuth, frame.fired, frame.sensor))


def image_of(frame: Frame, step: int) -> PaperImage:
    """A frame's image in steps of `step` x 2 mm: no range is off by more than half of it.

    Raises LidarCodecError if `step` is not at least 1.
    """
    if step < 1:
        raise LidarCodecError(f"a step of {step}: at least 1 is needed")
    canvas, sensor = canvas_of(frame), frame.sensor
    levels = level_offsets(sensor)[:, None]
    cells = np.where(frame.valid, (frame.range.astype(np.int32) + levels + step // 2) // step, 0).astype(np.int32)
    lasers = sensor.laser_of_ring
    half = (lasers >= LASERS_PER_BLOCK).astype(np.intp)
    turned = np.unwrap(frame.azimuth.astype(np.float64) * np.radians(AZIMUTH_STEP_DEG), axis=1) if frame.width else (
        np.zeros((2, 0)))  # fmt: skip
    beams = turned[half] - sensor.calibration["rot_correction_rad"][lasers][:, None]
    beams -= 2 * np.pi * np.rint((beams[:, :1] - beams[:1, :1]) / (2 * np.pi))
    elevation = np.broadcast_to(sensor.calibration["vert_correction_rad"][lasers][:, None], beams.shape)
    return PaperImage(
        canvas.spread(cells),
        canvas.spread(frame.valid),
        canvas.spread(beams.astype(np.float32)),
        canvas.spread(elevation.astype(np.float32)),
        step,
    )


def ranges_of(image: PaperImage, frame: Frame) -> npt.NDArray[np.uint16]:
    """(64, W) uint16 ranges that a decoder gets from an image, 0 where there is no return.

    frame: gives azimuths, mask and sensor; its ranges are not looked at
    """
    levels = level_offsets(frame.sensor)[:, None]
    cells = canvas_of(frame).gather(image.cells)
    return np.where(frame.valid, (cells * np.int32(image.step) - levels).clip(1, 65535), 0).astype(np.uint16)


def previous_valid(cells: Cells, valid: Mask) -> Cells:
    """(H, W) int32, for each cell the last valid one before it: in its row, else what stands so for the cell above.

    0 where there is none. The paper's first baseline. At the start of a row it looks up instead of at the end of the
    row above, on the other side of the turn's end, so that rows need not wait for the end of those above.
    """
    before = np.zeros_like(cells)
    if not cells.size:
        return before
    columns = np.arange(cells.shape[1])
    for row in range(len(cells)):  # 64 of them
        last = np.maximum.accumulate(np.where(valid[row], columns, -1))
        last = np.concatenate([[-1], last[:-1]])
        above = np.where(valid[row - 1], cells[row - 1], before[row - 1]) if row else before[0]
        before[row] = np.where(last >= 0, cells[row][np.maximum(last, 0)], above)
    return before

"""The canvas: a range image laid out so that neighbours in the image are neighbours in the world.

The lasers of one firing look up to 18 degrees apart, and each has a distance correction of its own. On the canvas each
row is shifted so that a column is one direction, and the corrections are added, in whole range steps, so that all rows
are on one scale. A JPEG needs 0.8 bits a point less for it, lossless JPEG XL 0.15 to 0.5. The
layout follows from the integer calibration table and two numbers sent with the image, so it can be reversed exactly.

Rows then end at different columns: the corners, up to 113 columns of an HDL-64E, hold nothing and are holes like any
other. With `compact`, columns in which no laser of a block of 32 has a return are left out for that block: an S3 fires
its upper block three times as often as its lower one.

>>> from lidarcodec.sensor_model import Calibration, SensorModel
>>> sensor = SensorModel("HDL-64E", Calibration.from_values({"rot_correction_rad": np.arange(64) % 2 * -0.004}))
>>> canvas = Canvas.of(sensor, np.ones((64, 5), np.bool_), (200_000, 200_000))
>>> canvas.width, canvas.shifts[:4].tolist()
(7, [0, 2, 0, 2])
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, TypeVar

import numpy as np
import numpy.typing as npt

from lidarcodec.errors import SectionError
from lidarcodec.sensor_model import CALIBRATION_FIELDS, SensorModel
from lidarcodec.units import AZIMUTH_TURN, LASERS, LASERS_PER_BLOCK, TABLE_TURN

Mask = npt.NDArray[np.bool_]
Pixel = TypeVar("Pixel", bound=np.generic)

MAX_SPAN: Final = 1024
"""Columns by which a canvas may be wider than its frame."""
MAX_OFFSET: Final = 1000
"""Largest difference of distance corrections that is compensated: 2 m."""
MAX_VALUE: Final = 65535 + MAX_OFFSET
"""Largest range on a canvas."""
_LENGTHS_PER_STEP: Final = 20_000
"""The table's units of length, 1e-7 m, in a range step of 2 mm."""
_FIELDS: Final = list(CALIBRATION_FIELDS)

Spacing = tuple[int, int]
"""Angle from one column to the next of the upper and of the lower block, 1e-8 rad; 0 = rows are not shifted."""


def level_offsets(sensor: SensorModel) -> npt.NDArray[np.int32]:
    """(64,) int32, range steps to add to each row so that all are on one scale; the smallest is 0.

    All 0 if the corrections differ by more than 2 m: such values are not plausible.
    """
    table = sensor.calibration.table[_FIELDS.index("dist_correction_m")][sensor.laser_of_ring].astype(np.int64)
    steps = (table - table.min() + _LENGTHS_PER_STEP // 2) // _LENGTHS_PER_STEP
    if int(steps.max()) > MAX_OFFSET:
        steps[:] = 0
    offsets: npt.NDArray[np.int32] = steps.astype(np.int32)
    return offsets


def _shifts(sensor: SensorModel, spacing: Spacing) -> npt.NDArray[np.int64]:
    """(64,) int64, columns by which each row moves to the right; the smallest is 0."""
    table = sensor.calibration.table[_FIELDS.index("rot_correction_rad")][sensor.laser_of_ring].astype(np.int64)
    angle = (table[0] - table + TABLE_TURN // 2) % TABLE_TURN - TABLE_TURN // 2
    apart = np.array(spacing, np.int64)[(sensor.laser_of_ring >= LASERS_PER_BLOCK).astype(np.intp)]
    shifts = np.where(apart > 0, (2 * angle + apart) // np.maximum(2 * apart, 1), 0)
    moved: npt.NDArray[np.int64] = shifts - shifts.min()
    return moved


def spacing_of(azimuth: npt.NDArray[np.uint16], fired: Mask, sensor: SensorModel) -> Spacing:
    """Mean angle between the columns of each block; (0, 0) if aligned rows would spread too far.

    azimuth: (2, W), 0.01 degree; fired: (2, W) bool.
    """
    found = []
    for half in range(2):
        turned = np.diff(azimuth[half][fired[half]].astype(np.int64)) % AZIMUTH_TURN
        found.append(int(turned.sum()) * TABLE_TURN // (AZIMUTH_TURN * len(turned)) if len(turned) else 0)
    spacing = (found[0], found[1])
    return spacing if int(_shifts(sensor, spacing).max()) <= MAX_SPAN else (0, 0)


@dataclass(frozen=True, eq=False)
class Canvas:
    """Where each cell of a frame of W columns lies on its canvas.

    shifts: (64,) int64, first column of each row; columns: those of the frame that each row holds, None for all of them
    width: columns of the canvas; frame_width: W
    """

    shifts: npt.NDArray[np.int64]
    columns: list[npt.NDArray[np.intp] | None]
    width: int
    frame_width: int

    @classmethod
    def of(
        cls, sensor: SensorModel, valid: Mask, spacing: Spacing, *, compact: bool = False, multiple: int = 1
    ) -> Canvas:
        """The canvas of a frame with these returns; its width is a multiple of `multiple`.

        valid: (64, W) bool. Raises SectionError if the rows would spread too far.
        """
        shifts = _shifts(sensor, spacing)
        if int(shifts.max()) > MAX_SPAN:
            raise SectionError(f"a canvas that spreads over {int(shifts.max())} columns: {MAX_SPAN} are possible")
        lower = sensor.laser_of_ring >= LASERS_PER_BLOCK
        held: list[npt.NDArray[np.intp] | None] = [None, None]
        if compact:
            held = [np.flatnonzero(valid[lower == half].any(axis=0)) for half in (False, True)]
        columns = [held[int(half)] for half in lower]
        frame_width = valid.shape[1]
        ends = [
            int(shift) + (frame_width if row is None else len(row))
            for shift, row in zip(shifts, columns, strict=True)
        ]  # fmt: skip
        width = -(-max(ends) // multiple) * multiple if frame_width else 0
        return cls(shifts, columns, width, frame_width)

    def spread(self, image: npt.NDArray[Pixel]) -> npt.NDArray[Pixel]:
        """(64, width), an image of the frame laid out on the canvas, zeros elsewhere. image: (64, W)."""
        out = np.zeros((LASERS, self.width), image.dtype)
        for row, (shift, columns) in enumerate(zip(self.shifts, self.columns, strict=True)):
            cells = image[row] if columns is None else image[row, columns]
            out[row, shift : shift + len(cells)] = cells
        return out

    def gather(self, canvas: npt.NDArray[Pixel]) -> npt.NDArray[Pixel]:
        """(64, W), the frame's cells out of a canvas; zeros in those that it does not hold. canvas: (64, width)."""
        out = np.zeros((LASERS, self.frame_width), canvas.dtype)
        for row, (shift, columns) in enumerate(zip(self.shifts, self.columns, strict=True)):
            if columns is None:
                out[row] = canvas[row, shift : shift + self.frame_width]
            else:
                out[row, columns] = canvas[row, shift : shift + len(columns)]
        return out

"""Mask coder: which cells of a range image hold a return, in about 0.15 bit a point.

Context of a cell are its neighbours to the left and in the two rows above, shifted by rotation correction, and, if one
is given, the mask of an earlier frame. Cells of a half that did not fire are not coded. Every message decodes alone:
the tables start afresh. The format is docs/wire-format-sections.md, section "mask".

>>> import numpy as np
>>> from lidarcodec.sensor_model import Calibration, SensorModel
>>> sensor = SensorModel("HDL-64E S2", Calibration.from_values({"vert_correction_rad": np.linspace(0.03, -0.43, 64)}))
>>> mask, fired = np.arange(64 * 10).reshape(64, 10) % 7 > 0, np.ones((2, 10), bool)
>>> bool((decode_mask(encode_mask(mask, fired, sensor), fired, sensor) == mask).all())
True
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from lidarcodec.entropy import fast
from lidarcodec.errors import SectionError
from lidarcodec.sensor_model import CALIBRATION_FIELDS, SensorModel
from lidarcodec.units import LASERS, LASERS_PER_BLOCK, MAX_COLUMNS

_ROTATION_ROW = list(CALIBRATION_FIELDS).index("rot_correction_rad")
_LONGEST_TURN = 65535


def encode_mask(
    mask: npt.NDArray[np.bool_],
    fired: npt.NDArray[np.bool_],
    sensor: SensorModel,
    previous: npt.NDArray[np.bool_] | None = None,
    *,
    turn: int | None = None,
) -> bytes:
    """Bytes of a mask; 1.3 ms a frame of 2088 columns.

    mask: (64, W) bool; fired: (2, W) bool; previous: (64, W') bool, the mask of an earlier frame, which decoding needs
    turn: columns in a full turn (`columns_in_turn`), 1 to 65535; by default found from the mask

    Raises SectionError if shapes do not fit, or a cell is set in a half that did not fire.
    """
    width = _width(fired)
    _check("mask", mask, (LASERS, width))
    if turn is not None and not 0 < turn <= _LONGEST_TURN:
        raise SectionError(f"a turn of {turn} columns: the limits are 1 and {_LONGEST_TURN}")
    mask, fired, previous = np.ascontiguousarray(mask), np.ascontiguousarray(fired), _earlier(previous)
    return fast.encode_mask(mask, fired, *row_geometry(sensor), previous, turn or 0)


def decode_mask(
    data: bytes,
    fired: npt.NDArray[np.bool_],
    sensor: SensorModel,
    previous: npt.NDArray[np.bool_] | None = None,
) -> npt.NDArray[np.bool_]:
    """(64, W) bool mask of the bytes; 1.2 ms a frame of 2088 columns.

    fired: (2, W) bool; previous: what the encoder was given.

    Raises SectionError or TruncatedError, also when the mask needs an earlier one that is not given.
    """
    _width(fired)
    return fast.decode_mask(data, np.ascontiguousarray(fired), *row_geometry(sensor), _earlier(previous))


def row_geometry(sensor: SensorModel) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.int32]]:
    """Of each row, (64,) each: half (uint8, 0 upper, 1 lower) and rotation correction (int32, steps of 1e-8 rad)."""
    half = (sensor.laser_of_ring >= LASERS_PER_BLOCK).astype(np.uint8)
    return half, np.ascontiguousarray(sensor.calibration.table[_ROTATION_ROW][sensor.laser_of_ring])


def _width(fired: npt.NDArray[np.bool_]) -> int:
    width = fired.shape[-1] if fired.ndim == 2 else -1
    if width > MAX_COLUMNS:
        raise SectionError(f"a frame of {width} columns: the limit is {MAX_COLUMNS}")
    _check("fired", fired, (2, width))
    return width


def _earlier(previous: npt.NDArray[np.bool_] | None) -> npt.NDArray[np.bool_]:
    if previous is None:
        return np.zeros((LASERS, 0), np.bool_)
    _check("an earlier mask", previous, (LASERS, previous.shape[-1] if previous.ndim == 2 else -1))
    return np.ascontiguousarray(previous)


def _check(name: str, array: npt.NDArray[np.bool_], shape: tuple[int, int]) -> None:
    if array.dtype != np.bool_ or array.shape != shape:
        raise SectionError(f"{name} is {array.dtype}{array.shape}, not bool{shape}")

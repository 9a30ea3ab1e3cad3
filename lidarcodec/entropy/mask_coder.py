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

from lidarcodec import _native
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
    check_fired(fired)
    check_cells("mask", mask, fired)
    columns = columns_of(turn)
    return _native.encode_mask(as_bytes(mask), *frame_geometry(fired, sensor), _earlier(previous), columns)


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
    check_fired(fired)
    return _native.decode_mask(data, *frame_geometry(fired, sensor), _earlier(previous)).view(np.bool_)


def row_geometry(sensor: SensorModel) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.int32]]:
    """Of each row, (64,) each: half (uint8, 0 upper, 1 lower) and rotation correction (int32, steps of 1e-8 rad)."""
    half = (sensor.laser_of_ring >= LASERS_PER_BLOCK).astype(np.uint8)
    return half, np.ascontiguousarray(sensor.calibration.table[_ROTATION_ROW][sensor.laser_of_ring])


def frame_geometry(
    fired: npt.NDArray[np.bool_], sensor: SensorModel
) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.uint8], npt.NDArray[np.int32]]:
    """What the native coders need to know of a frame: what fired, (2, W) uint8, and `row_geometry`."""
    return as_bytes(fired), *row_geometry(sensor)


def as_bytes(cells: npt.NDArray[np.bool_]) -> npt.NDArray[np.uint8]:
    """The cells as the native coders take them: contiguous uint8."""
    return np.ascontiguousarray(cells).view(np.uint8)


def columns_of(turn: int | None) -> int:
    """Columns in a full turn as the native coders take them: 0 if they are to find it.

    Raises SectionError for a number that no turn has.
    """
    if turn is not None and not 0 < turn <= _LONGEST_TURN:
        raise SectionError(f"a turn of {turn} columns: the limits are 1 and {_LONGEST_TURN}")
    return turn or 0


def check_fired(fired: npt.NDArray[np.bool_]) -> None:
    """Raises SectionError if this is not (2, W) bool, or wider than a frame can be."""
    width = fired.shape[-1] if fired.ndim == 2 else -1
    if width > MAX_COLUMNS:
        raise SectionError(f"a frame of {width} columns: the limit is {MAX_COLUMNS}")
    _check("fired", fired, (2, width))


def check_cells(name: str, cells: npt.NDArray[np.bool_], fired: npt.NDArray[np.bool_]) -> None:
    """Raises SectionError if the cells are not (64, W) bool."""
    _check(name, cells, (LASERS, fired.shape[1]))


def _earlier(previous: npt.NDArray[np.bool_] | None) -> npt.NDArray[np.uint8]:
    if previous is None:
        return np.zeros((LASERS, 0), np.uint8)
    _check("an earlier mask", previous, (LASERS, previous.shape[-1] if previous.ndim == 2 else -1))
    return as_bytes(previous)


def _check(name: str, array: npt.NDArray[np.bool_], shape: tuple[int, int]) -> None:
    if array.dtype != np.bool_ or array.shape != shape:
        raise SectionError(f"{name} is {array.dtype}{array.shape}, not bool{shape}")

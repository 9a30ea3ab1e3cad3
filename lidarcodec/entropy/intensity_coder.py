"""Intensity coder: the intensities of returns, in about 3.8 bit a return on KITTI's 100 levels (xz: 4.35).

Context of a return are the last four of its row, the row above shifted by rotation correction, and the no returns
beside it. What follows which context is learned while coding, and afresh in a message that decodes alone. The parts of
a turn go on from each other, and in codecs with memory frames do (`IntensityMemory`). Then the row, and what was sent
in this direction a turn ago, are contexts too. Values that do not occur cost nothing: intensities reduced to few levels
(`choose_levels`) are cheaper accordingly. The format is docs/wire-format-intensity.md.

>>> import numpy as np
>>> from lidarcodec.sensor_model import Calibration, SensorModel
>>> sensor = SensorModel("HDL-64E S2", Calibration.from_values({"vert_correction_rad": np.linspace(0.03, -0.43, 64)}))
>>> values = (np.arange(64 * 10) % 50).astype(np.uint8).reshape(64, 10)
>>> returns, fired = values > 6, np.ones((2, 10), bool)
>>> came = decode_intensity(encode_intensity(values, returns, fired, sensor), returns, fired, sensor)
>>> bool((came == np.where(returns, values, 0)).all())
True
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from lidarcodec import _native
from lidarcodec.entropy.mask_coder import as_bytes, check_cells, check_fired, columns_of, frame_geometry
from lidarcodec.errors import SectionError
from lidarcodec.sensor_model import SensorModel

IntensityMemory = _native.IntensityMemory
"""What sections taught; of none when it is made. For one stream. follows: whether its frames go on from each other,
beside the parts of a turn."""


def encode_intensity(
    values: npt.NDArray[np.uint8],
    returns: npt.NDArray[np.bool_],
    fired: npt.NDArray[np.bool_],
    sensor: SensorModel,
    *,
    turn: int | None = None,
    memory: IntensityMemory | None = None,
    azimuth: npt.NDArray[np.uint16] | None = None,
) -> bytes:
    """Bytes of the intensities of the cells set in `returns`; 4 ms for 120,000 of them.

    values: (64, W) uint8; returns: (64, W) bool, which decoding needs; fired: (2, W) bool
    turn: columns in a full turn (`columns_in_turn`), 1 to 65535; by default found from the returns
    memory: what to go on from, changed; without it, or where a value is new, the section begins anew
    azimuth: (2, W) uint16, below 36000, of a memory that follows frames

    Raises SectionError if shapes do not fit, or a cell is set in a half that did not fire.
    """
    _check_values(values, returns, fired)
    columns = columns_of(turn)
    image, angles = np.ascontiguousarray(values), _angles(azimuth)
    return _native.encode_intensity(image, as_bytes(returns), *frame_geometry(fired, sensor), columns, memory, angles)


def choose_levels(
    values: npt.NDArray[np.uint8],
    returns: npt.NDArray[np.bool_],
    fired: npt.NDArray[np.bool_],
    sensor: SensorModel,
    levels: int,
) -> npt.NDArray[np.uint8]:
    """(64, W) uint8 with at most `levels` values at the returns, 0 elsewhere; 4 ms for 120,000 returns.

    Values, and which of them each return becomes, are chosen for small errors and few bits of `encode_intensity`: by
    Lloyd's method for the values, then along each row by Viterbi's with prices of how values follow each other.
    Intensities that have no more than `levels` values stay as they are.

    values: (64, W) uint8; returns: (64, W) bool; fired: (2, W) bool; levels: 2 to 255. Raises SectionError.
    """
    _check_values(values, returns, fired)
    if not 2 <= levels <= 255:
        raise SectionError(f"{levels} intensity levels: 2 to 255 are possible")
    image = np.ascontiguousarray(values)
    return _native.choose_levels(image, as_bytes(returns), *frame_geometry(fired, sensor), levels)


def decode_intensity(
    data: bytes,
    returns: npt.NDArray[np.bool_],
    fired: npt.NDArray[np.bool_],
    sensor: SensorModel,
    *,
    memory: IntensityMemory | None = None,
    azimuth: npt.NDArray[np.uint16] | None = None,
) -> npt.NDArray[np.uint8]:
    """(64, W) uint8 intensities of the bytes, 0 outside of `returns`; 5 ms for 120,000 of them.

    returns: (64, W) bool; fired: (2, W) bool; azimuth: (2, W) uint16, below 36000; all as the encoder was given
    memory: of all sections before this one; changed

    Raises SectionError or TruncatedError.
    """
    check_returns(returns, fired)
    return _native.decode_intensity(data, as_bytes(returns), *frame_geometry(fired, sensor), memory, _angles(azimuth))


def _angles(azimuth: npt.NDArray[np.uint16] | None) -> npt.NDArray[np.uint16] | None:
    return None if azimuth is None else np.ascontiguousarray(azimuth, np.uint16)


def _check_values(values: npt.NDArray[np.uint8], returns: npt.NDArray[np.bool_], fired: npt.NDArray[np.bool_]) -> None:
    check_returns(returns, fired)
    if values.dtype != np.uint8 or values.shape != returns.shape:
        raise SectionError(f"intensities are {values.dtype}{values.shape}, not uint8{returns.shape}")


def check_returns(returns: npt.NDArray[np.bool_], fired: npt.NDArray[np.bool_]) -> None:
    """Raises SectionError if the arrays are not (64, W) and (2, W) bool, or wider than a frame can be."""
    check_fired(fired)
    check_cells("returns", returns, fired)

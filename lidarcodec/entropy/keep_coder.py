"""Keep coder: which returns of a reduced frame are left, in about three bits a return of `voxel`.

A message says it in the way that takes fewer bytes: as a mask of returns (`mask_coder`), which suits whole columns,
or as few cells on a lattice of directions. The format is docs/wire-format-keep.md. Every message decodes alone, but for
the earlier mask that it may refer to.

>>> import numpy as np
>>> from lidarcodec.sensor_model import Calibration, SensorModel
>>> sensor = SensorModel("HDL-64E", Calibration.from_values({"vert_correction_rad": np.linspace(0.03, -0.43, 64)}))
>>> keep, fired = np.arange(64 * 100).reshape(64, 100) % 97 == 0, np.ones((2, 100), bool)
>>> azimuth = np.tile(np.arange(0, 1800, 18, dtype=np.uint16), (2, 1))
>>> data = encode_keep(keep, azimuth, fired, sensor)
>>> bool((decode_keep(data, azimuth, fired, sensor) == keep).all())
True
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from lidarcodec import _native
from lidarcodec.entropy.mask_coder import as_bytes, decode_mask, encode_mask, frame_geometry
from lidarcodec.errors import SectionError
from lidarcodec.sensor_model import SensorModel
from lidarcodec.units import LASERS

SPARSE, SPARSE_WITH_EARLIER = 4, 5
"""Kinds of a KEEP section that no MASK section has."""

Mask = npt.NDArray[np.bool_]
Azimuth = npt.NDArray[np.uint16]


def encode_keep(
    keep: Mask,
    azimuth: Azimuth,
    fired: Mask,
    sensor: SensorModel,
    previous: Mask | None = None,
    *,
    turn: int | None = None,
) -> bytes:
    """Bytes of a keep mask; 4 ms a frame of 2088 columns.

    keep: (64, W) bool; azimuth: (2, W) uint16, 0.01 degree, below 36000; fired: (2, W) bool
    previous: (64, W) bool, what was last sent in the direction of each cell; turn: as of `encode_mask`

    Raises SectionError if shapes do not fit, or a cell is set in a half that did not fire.
    """
    dense = encode_mask(keep, fired, sensor, previous, turn=turn)
    if len(dense) == 1:
        return dense
    given = (_azimuth(azimuth, fired), *frame_geometry(fired, sensor), _earlier(previous, fired.shape[1]))
    sparse = _native.encode_keep(as_bytes(keep), *given)
    return min(sparse, dense, key=len)


def decode_keep(data: bytes, azimuth: Azimuth, fired: Mask, sensor: SensorModel, previous: Mask | None = None) -> Mask:
    """(64, W) bool mask of the bytes; 3 ms a frame of 2088 columns. All else as the encoder was given it.

    Raises SectionError or TruncatedError, also when the mask needs an earlier one that is not given.
    """
    if not data or data[0] not in (SPARSE, SPARSE_WITH_EARLIER):
        return decode_mask(data, fired, sensor, previous)
    given = (_azimuth(azimuth, fired), *frame_geometry(fired, sensor), _earlier(previous, fired.shape[1]))
    return _native.decode_keep(data, *given).view(np.bool_)


def _azimuth(azimuth: Azimuth, fired: Mask) -> Azimuth:
    if azimuth.dtype != np.uint16 or azimuth.shape != fired.shape or fired.shape[:1] != (2,):
        raise SectionError(f"azimuths are {azimuth.dtype}{azimuth.shape}, what fired is {fired.shape}")
    return np.ascontiguousarray(azimuth)


def _earlier(previous: Mask | None, width: int) -> npt.NDArray[np.uint8]:
    if previous is None:
        return np.zeros((LASERS, 0), np.uint8)
    if previous.dtype != np.bool_ or previous.shape != (LASERS, width):
        raise SectionError(f"an earlier mask is {previous.dtype}{previous.shape}, not bool{(LASERS, width)}")
    return as_bytes(previous)

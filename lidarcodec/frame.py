"""Frame: consecutive packets as images. Range, intensity and azimuth are the sensor's own integers."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from lidarcodec.cloud import cloud_of
from lidarcodec.errors import LidarCodecError
from lidarcodec.sensor_model import SensorModel
from lidarcodec.side import SideInfo
from lidarcodec.units import LASERS, MAX_COLUMNS


def _may_change(array: npt.NDArray[Any]) -> bool:
    """Whether the array is a view of memory that can still be written. An array that owns its data is not copied."""
    base = array.base
    while isinstance(base, np.ndarray):
        if base.flags.writeable:
            return True
        base = base.base
    return array.base is not None and array.flags.writeable


@dataclass(frozen=True, eq=False)
class Frame:
    """A frame; W columns. Immutable: arrays are made read-only and C-contiguous.

    index:     counts the frames of a stream from 0
    stamp_ns:  host time of the first packet, ns since the Unix epoch
    range:     (64, W) uint16, steps of 2 mm, 0 = no return; row 0 is the highest beam
    intensity: (64, W) uint8; may be non-zero where there is no return
    azimuth:   (2, W) uint16, 0.01 degree, 0..35999: of each column's upper and lower block (a half that was not fired
               repeats the other)
    fired:     (2, W) bool, which half of a column was sent; a cell that did not fire is not a no-return
    sensor:    name, units and calibration
    side:      time stamps, status bytes and the like, for exact packets; None for a frame that is not made of packets
    keep:      (64, W) bool or None: returns that a reducer keeps; the others decode as no return
    pose:      (4, 4) float64 or None: T_world_sensor at stamp_ns
    lattice:   (K,) uint16 or None: the columns that are sent, ascending, where a frame is thinned to some of them
    filled:    (64, W) bool or None: returns that a receiver interpolated between those columns; they are never sent
    """

    index: int
    stamp_ns: int
    range: npt.NDArray[np.uint16]
    intensity: npt.NDArray[np.uint8]
    azimuth: npt.NDArray[np.uint16]
    fired: npt.NDArray[np.bool_]
    sensor: SensorModel
    side: SideInfo | None = None
    keep: npt.NDArray[np.bool_] | None = None
    pose: npt.NDArray[np.float64] | None = None
    lattice: npt.NDArray[np.uint16] | None = None
    filled: npt.NDArray[np.bool_] | None = None

    def __post_init__(self) -> None:
        shape_of_range = getattr(self.range, "shape", None)
        width = shape_of_range[1] if shape_of_range and len(shape_of_range) == 2 else -1
        if not 0 <= width <= MAX_COLUMNS:
            raise LidarCodecError(f"a range image is (64, W) with W up to {MAX_COLUMNS}, not {shape_of_range}")
        wanted: dict[str, tuple[npt.DTypeLike, tuple[int, ...]]] = {
            "range": (np.uint16, (LASERS, width)),
            "intensity": (np.uint8, (LASERS, width)),
            "azimuth": (np.uint16, (2, width)),
            "fired": (np.bool_, (2, width)),
            "keep": (np.bool_, (LASERS, width)),
            "pose": (np.float64, (4, 4)),
            "lattice": (np.uint16, (-1 if self.lattice is None else len(self.lattice),)),
            "filled": (np.bool_, (LASERS, width)),
        }
        for name, (dtype, shape) in wanted.items():
            array = getattr(self, name)
            if array is None and name in ("keep", "pose", "lattice", "filled"):
                continue
            if not isinstance(array, np.ndarray) or array.dtype != dtype or array.shape != shape:
                found = f"{array.dtype}{array.shape}" if isinstance(array, np.ndarray) else type(array).__name__
                raise LidarCodecError(f"frame.{name} is {found}, not {np.dtype(dtype)}{shape}")
            if not array.flags.c_contiguous or _may_change(array):
                array = np.array(array, order="C")
            array.flags.writeable = False
            object.__setattr__(self, name, array)

    @property
    def width(self) -> int:
        """Number of columns, W."""
        return int(self.range.shape[1])

    @cached_property
    def valid(self) -> npt.NDArray[np.bool_]:
        """(64, W) bool, the returns that are sent: range above 0, not dropped by a reducer. Read-only."""
        returned: npt.NDArray[np.bool_] = self.range > 0
        valid = returned if self.keep is None else returned & self.keep
        valid.flags.writeable = False
        return valid

    @property
    def points(self) -> int:
        """Number of returns, dropped ones included."""
        return int(np.count_nonzero(self.range))

    def with_(self, **changes: Any) -> Frame:
        """A copy with some fields changed."""
        return replace(self, **changes)

    def cloud(self) -> npt.NDArray[np.void]:
        """Structured array of the frame's valid returns, column by column: x y z f4 (metres, x forward, y left, z up),
        intensity u1, laser u1 (hardware id), ring u1 (row), t_ns i8 (host time)."""
        return cloud_of(self)

"""Frame: consecutive packets as images. Range, intensity and azimuth are the sensor's own integers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import MappingProxyType
from typing import Any, Final, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from lidarcodec.cloud import cloud_of
from lidarcodec.errors import LidarCodecError, SettingsError
from lidarcodec.packet_rest import PacketRest
from lidarcodec.sensor_model import SensorModel
from lidarcodec.side import SideInfo
from lidarcodec.units import MAX_COLUMNS

OPTIONAL: Final = ("keep", "pose", "mount", "lattice", "filled")
"""Arrays that a frame can do without."""
PLANE_DTYPES: Final = frozenset(map(np.dtype, (np.uint8, np.uint16, np.uint32)))


class Part(NamedTuple):
    """Whether a frame is a part of a turn: goes_on: that of the frame before; more: another part of it follows."""

    goes_on: bool = False
    more: bool = False


WHOLE: Final = Part()


def _may_change(array: npt.NDArray[Any]) -> bool:
    """Whether the array is a view of memory that can still be written. An array that owns its data is not copied."""
    base = array.base
    while isinstance(base, np.ndarray):
        if base.flags.writeable:
            return True
        base = base.base
    return array.base is not None and array.flags.writeable


def _read_only(array: Any, name: str, dtype: npt.DTypeLike, shape: tuple[int, ...]) -> npt.NDArray[Any]:
    """The array, C-contiguous and read-only: itself, or a copy. Raises LidarCodecError if type or shape is wrong."""
    if not isinstance(array, np.ndarray) or array.dtype != dtype or array.shape != shape:
        given = f"{array.dtype}{array.shape}" if isinstance(array, np.ndarray) else type(array).__name__
        raise LidarCodecError(f"frame.{name} is {given}, not {np.dtype(dtype)}{shape}")
    if not array.flags.c_contiguous or _may_change(array):
        array = np.array(array, order="C")
    found: npt.NDArray[Any] = array
    found.flags.writeable = False
    return found


@dataclass(frozen=True, eq=False)
class Frame:
    """A frame; H rows, W columns. Immutable: arrays are made read-only and C-contiguous.

    index:     counts the frames of a stream from 0
    stamp_ns:  host time of the first packet, ns since the Unix epoch
    range:     (H, W) uint32, steps of `sensor.range_step_m`, 0 = no return; row 0 is the highest beam. uint16 is taken,
               and widened
    intensity: (H, W) uint8, or uint16 of a sensor that sends more; may be non-zero where there is no return
    azimuth:   (2, W) uint16, 0.01 degree, 0..35999: of each column's upper and lower block (a half that was not fired
               repeats the other)
    fired:     (2, W) bool, which half of a column was sent; a cell that did not fire is not a no-return
    sensor:    name, units and calibration
    side:      time stamps, status bytes and the like, for exact packets: a SideInfo of an HDL-64E, a PacketRest of
               other sensors; None for a frame that is not made of packets
    planes:    further images by name, (H, W) uint8, uint16 or uint32: `range2` and `intensity2` (second return),
               `signal`, `near_ir`, ...; empty for an HDL-64E
    keep:      (H, W) bool or None: returns that a reducer keeps; the others decode as no return
    pose:      (4, 4) float64 or None: T_world_sensor at stamp_ns
    lattice:   (K,) uint16 or None: the columns that are sent, ascending, where a frame is thinned to some of them
    mount:     (4, 4) float64 or None: T_vehicle_sensor, where the sensor sits on its vehicle
    part:      with `framing=parts:N`: which part of its turn the frame is
    filled:    (H, W) bool or None: returns that a receiver interpolated between those columns; they are never sent
    """

    index: int
    stamp_ns: int
    range: npt.NDArray[Any]
    intensity: npt.NDArray[Any]
    azimuth: npt.NDArray[np.uint16]
    fired: npt.NDArray[np.bool_]
    sensor: SensorModel
    side: SideInfo | PacketRest | None = None
    keep: npt.NDArray[np.bool_] | None = None
    pose: npt.NDArray[np.float64] | None = None
    lattice: npt.NDArray[np.uint16] | None = None
    filled: npt.NDArray[np.bool_] | None = None
    planes: Mapping[str, npt.NDArray[np.unsignedinteger]] = field(default_factory=dict)
    mount: npt.NDArray[np.float64] | None = None
    part: Part = WHOLE

    def __post_init__(self) -> None:
        shape: tuple[int, ...] = getattr(self.range, "shape", ())
        rows, width = self.sensor.rows, shape[1] if len(shape) == 2 else -1
        if not 0 <= width <= MAX_COLUMNS:
            raise LidarCodecError(f"a range image is ({rows}, W) with W up to {MAX_COLUMNS}, not {shape}")
        hdl64e = self.sensor.is_hdl64e
        attribute = np.uint8 if hdl64e or self.intensity.dtype == np.uint8 else np.uint16
        image, halves = (rows, width), (2, width)
        given = getattr(self.range, "dtype", None)
        if given == np.uint16:
            narrow = _read_only(self.range, "range", np.uint16, image)
            if hdl64e:
                self.__dict__["range_u16"] = narrow
            object.__setattr__(self, "range", narrow.astype(np.uint32))
        elif hdl64e and given == np.uint32 and self.range.max(initial=0) > 0xFFFF:
            raise LidarCodecError(f"a range of an HDL-64E has 16 bits, and this is {self.range.max()}")
        wanted: dict[str, tuple[npt.DTypeLike, tuple[int, ...]]] = {
            "range": (np.uint32, image),
            "intensity": (attribute, image),
            "azimuth": (np.uint16, halves),
            "fired": (np.bool_, halves),
            "keep": (np.bool_, image),
            "pose": (np.float64, (4, 4)),
            "mount": (np.float64, (4, 4)),
            "lattice": (np.uint16, (-1 if self.lattice is None else len(self.lattice),)),
            "filled": (np.bool_, image),
        }
        for name, (dtype, wants) in wanted.items():
            array = getattr(self, name)
            if array is not None or name not in OPTIONAL:
                object.__setattr__(self, name, _read_only(array, name, dtype, wants))
        if self.planes:
            planes = {
                name: _read_only(plane, f"planes[{name!r}]", plane.dtype, image) for name, plane in self.planes.items()
            }
            if hdl64e or any(plane.dtype not in PLANE_DTYPES for plane in planes.values()):
                raise LidarCodecError(
                    "further planes are unsigned images of up to 32 bits, of other sensors than an HDL-64E"
                )
            object.__setattr__(self, "planes", MappingProxyType(planes))

    @property
    def blocks(self) -> SideInfo | None:
        """The side information of an HDL-64E's packets.

        Raises LidarCodecError for a frame of another sensor: the caller takes only an HDL-64E.
        """
        if isinstance(self.side, PacketRest):
            raise LidarCodecError(f"this works only with frames of an HDL-64E, not of a {self.sensor.name}")
        return self.side

    @cached_property
    def range_u16(self) -> npt.NDArray[np.uint16]:
        """(H, W) uint16, the ranges of an HDL-64E, as its coders take them. Read-only.

        Raises LidarCodecError for a frame of another sensor.
        """
        if not self.sensor.is_hdl64e:
            raise LidarCodecError(f"this works only with frames of an HDL-64E, not of a {self.sensor.name}")
        return _read_only(self.range.astype(np.uint16), "range", np.uint16, self.range.shape)

    @property
    def width(self) -> int:
        """Number of columns, W."""
        return int(self.range.shape[1])

    @cached_property
    def valid(self) -> npt.NDArray[np.bool_]:
        """(H, W) bool, the returns that are sent: range above 0, not dropped by a reducer. Read-only."""
        returned: npt.NDArray[np.bool_] = self.range > 0
        valid = returned if self.keep is None else returned & self.keep
        valid.flags.writeable = False
        return valid

    @property
    def points(self) -> int:
        """Number of returns, dropped ones included."""
        return int(np.count_nonzero(self.range))

    def __reduce__(self) -> tuple[Any, ...]:
        """For pickle and `multiprocessing`: half a megabyte for a turn of an HDL-64E."""
        ranges = self.range_u16 if self.sensor.is_hdl64e else self.range
        fields: list[Any] = [self.index, self.stamp_ns, ranges, self.intensity, self.azimuth, self.fired, self.sensor]
        fields += [self.side, self.keep, self.pose, self.lattice, self.filled, dict(self.planes), self.mount]
        fields += [self.part]
        return type(self), tuple(fields)

    def with_(self, **changes: Any) -> Frame:
        """A copy with some fields changed."""
        return replace(self, **changes)

    def cloud(self, returns: Literal["first", "all"] = "first") -> npt.NDArray[np.void]:
        """Structured array of the frame's valid returns, column by column: x y z f4 (metres, x forward, y left, z up),
        intensity u1 (u2 of a sensor that sends more), laser u1 (hardware id), ring u1 (row), t_ns i8 (host time).

        returns: `all` adds the second returns, and a field `return_number` u1 (1 or 2). Of other sensors than an
        HDL-64E the cloud has a field for each further plane, such as `signal` and `near_ir`.
        """
        return cloud_of(self, returns)


def several(given: object, function: str, kind: str) -> None:
    """Raise SettingsError if a single frame or message was given to a function that takes `kind`, many of them."""
    if isinstance(given, Frame | bytes):
        raise SettingsError(f"{function} takes a sequence of {kind}: write [{kind[:-1]}] for a single one", kind)

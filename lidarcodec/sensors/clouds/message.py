"""`sensor_msgs/PointCloud2` taken apart: the head before the points, the points, and the bytes behind them.

A *payload* is a message with four bytes before it that say its form: those of CDR (`00 01 00 00`, ROS 2, which a ROS 2
message begins with anyway), or `ros1`, after which the bytes of a ROS 1 message follow.

    header (ROS 1: seq u32;  stamp, frame_id), height, width, fields, is_bigendian, point_step, row_step, data, is_dense

Sources: sensor_msgs/PointCloud2.msg and PointField.msg; wiki.ros.org, "Technical overview of roscpp", serialization.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from lidarcodec.errors import SectionError, TruncatedError

ROS1: Final = b"ros1"
CDR: Final = frozenset({b"\0\0\0\0", b"\0\1\0\0"})
MAX_MESSAGE: Final = 32 * 2**20
"""Most bytes of a message: 400,000 points of 80 bytes."""
MAX_POINTS: Final = 1 << 20
"""Most points of which an image is made, and whose columns are coded apart."""
MAX_FIELDS: Final = 64
MAX_TEXT: Final = 4096
_TYPES: Final = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
TYPE_NUMBERS: Final = {name: number for number, name in _TYPES.items()}


class CloudField(NamedTuple):
    """A field of each point: name, first byte, type as numpy has it without byte order (`f4`), number of values."""

    name: str
    offset: int
    kind: str
    repeated: int


class _Values:
    """Values of a message one after the other; CDR aligns them to their size, ROS 1 does not."""

    def __init__(self, data: bytes, order: str, *, aligned: bool) -> None:
        self._data, self._order, self._aligned, self.at = data, order, aligned, 4

    def u8(self) -> int:
        return self._take(1)[0]

    def u32(self) -> int:
        if self._aligned:
            self.at += -self.at % 4
        return int(struct.unpack(f"{self._order}I", self._take(4))[0])

    def i32(self) -> int:
        number = self.u32()
        return number - (number >> 31 << 32)

    def text(self) -> str:
        size = self.u32()
        if size > MAX_TEXT:
            raise SectionError(f"a text of {size} bytes in a PointCloud2: the limit is {MAX_TEXT}")
        return self._take(size).rstrip(b"\0").decode("utf-8", "backslashreplace")

    def _take(self, size: int) -> bytes:
        found = self._data[self.at : self.at + size]
        if len(found) < size:
            raise TruncatedError("a PointCloud2 message ends too early", self.at)
        self.at += size
        return found


@dataclass(frozen=True, eq=False)
class CloudHead:
    """What stands before the points. size: its bytes; data_bytes: of all rows of points

    stamp_ns is the time of the header; fields in their order; big_endian: of the points
    """

    size: int
    stamp_ns: int
    frame_id: str
    height: int
    width: int
    fields: tuple[CloudField, ...]
    big_endian: bool
    point_step: int
    row_step: int
    data_bytes: int

    @property
    def points(self) -> int:
        """Number of points, those without a return too."""
        return self.height * self.width

    @property
    def regular(self) -> bool:
        """Whether the points lie where step and row step say, and each field within its point."""
        inside = all(one.offset + np.dtype(one.kind).itemsize * one.repeated <= self.point_step for one in self.fields)
        rows = self.width * self.point_step <= self.row_step or self.height <= 1
        row_step = self.row_step if self.height > 1 else self.width * self.point_step
        return inside and rows and self.point_step > 0 and self.data_bytes == row_step * self.height

    @cached_property
    def by_name(self) -> dict[str, CloudField]:
        """The fields of one value by name; of two with a name the first."""
        return {one.name: one for one in reversed(self.fields) if one.repeated == 1}

    def dtype_of(self, field: CloudField) -> np.dtype[Any]:
        """Of one value of a field, in the byte order of the points."""
        return np.dtype(field.kind).newbyteorder(">" if self.big_endian else "<")


def read_head(payload: bytes) -> CloudHead:
    """The head of a payload; the points need not be there.

    Raises SectionError if this is no PointCloud2, TruncatedError if it ends within the head.
    """
    form = payload[:4]
    if form != ROS1 and form not in CDR:
        raise SectionError(f"a message that begins with {form.hex(' ') or 'nothing'} is not a PointCloud2")
    values = _Values(payload, ">" if form == b"\0\0\0\0" else "<", aligned=form != ROS1)
    if form == ROS1:
        values.u32()  # the sequence number
        stamp_ns = values.u32() * 10**9 + values.u32()
    else:
        stamp_ns = values.i32() * 10**9 + values.u32()
    frame_id = values.text()
    height, width, count = values.u32(), values.u32(), values.u32()
    if count > MAX_FIELDS:
        raise SectionError(f"a PointCloud2 of {count} fields: the limit is {MAX_FIELDS}")
    fields = []
    for _ in range(count):
        name, offset, kind, repeated = values.text(), values.u32(), values.u8(), values.u32()
        if kind not in _TYPES:
            raise SectionError(f"field '{name:.60}' has the unknown type {kind}")
        fields.append(CloudField(name, offset, _TYPES[kind], repeated))
    big_endian = values.u8() != 0
    point_step, row_step, data_bytes = values.u32(), values.u32(), values.u32()
    if data_bytes > MAX_MESSAGE or height * width > MAX_MESSAGE:
        raise SectionError(f"a PointCloud2 of {data_bytes} bytes: the limit is {MAX_MESSAGE}")
    return CloudHead(
        values.at, stamp_ns, frame_id, height, width, tuple(fields), big_endian, point_step, row_step, data_bytes
    )


@dataclass(frozen=True, eq=False)
class CloudMessage:
    """A message: payload, head, and (N, point_step) bytes of its points.

    between: (height, padding) bytes behind the points of each row; tail: bytes behind all points
    """

    payload: bytes
    head: CloudHead
    points: npt.NDArray[np.uint8]
    between: npt.NDArray[np.uint8]
    tail: bytes

    @cached_property
    def _found(self) -> dict[str, npt.NDArray[Any] | None]:
        return {}

    def values(self, name: str) -> npt.NDArray[Any] | None:
        """(N,) values of the field of that name in the machine's byte order; None if there is none of one value."""
        if name not in self._found:
            field = self.head.by_name.get(name)
            self._found[name] = None if field is None else column_of(self.points, self.head, field)
        return self._found[name]

    @cached_property
    def xyz(self) -> npt.NDArray[np.float64] | None:
        """(3, N) float64, metres; None without all three of them as numbers."""
        axes = [self.values(name) for name in "xyz"]
        if any(axis is None or axis.dtype.kind != "f" for axis in axes):
            return None
        with np.errstate(invalid="ignore"):
            found: npt.NDArray[np.float64] = np.stack([np.asarray(axis, np.float64) for axis in axes])
        return found

    @cached_property
    def returns(self) -> npt.NDArray[np.bool_]:
        """(N,) bool, points with finite x, y and z that are not all 0, and within 1,000 km."""
        axes = [self.values(name) for name in "xyz"]
        if any(axis is None or axis.dtype.kind != "f" for axis in axes):
            return np.zeros(self.head.points, np.bool_)
        x, y, z = (np.asarray(axis) for axis in axes)
        with np.errstate(invalid="ignore"):
            near = (np.abs(x) < 1e6) & (np.abs(y) < 1e6) & (np.abs(z) < 1e6)
        found: npt.NDArray[np.bool_] = near & ((x != 0) | (y != 0) | (z != 0))
        return found


def column_of(points: npt.NDArray[np.uint8], head: CloudHead, field: CloudField) -> npt.NDArray[Any]:
    """(N,) values of a field in the machine's byte order."""
    return values_at(points, field.offset, head.dtype_of(field))


def values_at(points: npt.NDArray[np.uint8], at: int, dtype: np.dtype[Any]) -> npt.NDArray[Any]:
    """(N,) values in the machine's byte order, of C-contiguous (N, step) bytes: those from byte `at` of each row on."""
    if not len(points):
        return np.zeros(0, dtype.newbyteorder("="))
    view: npt.NDArray[Any] = np.ndarray(len(points), dtype, points, at, (points.shape[1],))
    return view.astype(dtype.newbyteorder("="))


def read_message(payload: bytes) -> CloudMessage:
    """A whole message.

    Raises SectionError if this is no PointCloud2, its points do not lie as it says, or it ends too early.
    """
    head = read_head(payload)
    end = head.size + head.data_bytes
    if not head.regular or end > len(payload):
        size = f"{head.height} x {head.width} points of {head.point_step} bytes"
        raise SectionError(f"a PointCloud2 of {size} in {head.data_bytes} bytes")
    data = np.frombuffer(payload, np.uint8, head.data_bytes, head.size)
    rows = data.reshape(head.height, -1) if head.data_bytes else np.zeros((head.height, 0), np.uint8)
    used = head.width * head.point_step if head.data_bytes else 0
    points = np.ascontiguousarray(rows[:, :used]).reshape(-1, head.point_step)
    return CloudMessage(payload, head, points, rows[:, used:], payload[end:])

"""The C library (native/include/lidarcodec.h) by ctypes, as a decoder of streams for tests."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from lidarcodec.errors import (
    ChecksumError,
    DecodeError,
    HeaderError,
    MissingReferenceError,
    SectionError,
    TruncatedError,
    UnsupportedVersionError,
)

FIRST, ALL = 1, 2
ERRORS: dict[int, type[DecodeError]] = {
    1: HeaderError,
    2: UnsupportedVersionError,
    3: TruncatedError,
    4: ChecksumError,
    5: SectionError,
    6: MissingReferenceError,
}
"""The error of the package for each status of the library."""
POINT = np.dtype(
    [(axis, "f4") for axis in "xyz"]
    + [("intensity", "u4"), ("cell", "u4"), ("laser", "u1"), ("ring", "u1"), ("return_number", "u1"), ("_", "u1")]
    + [("t_ns", "i8")]
)


class _Frame(ctypes.Structure):
    _fields_ = (
        ("stream_id", ctypes.c_uint64),
        ("index", ctypes.c_uint64),
        ("stamp_ns", ctypes.c_int64),
        ("codec", ctypes.c_uint16),
        ("key", ctypes.c_uint8),
        ("has_intensity", ctypes.c_uint8),
        ("rows", ctypes.c_uint32),
        ("width", ctypes.c_uint32),
        ("points", ctypes.c_uint32),
        ("plane_count", ctypes.c_uint32),
        ("range_step_m", ctypes.c_double),
        ("planes", ctypes.c_void_p),
        ("azimuth", ctypes.c_void_p),
        ("fired", ctypes.c_void_p),
        ("laser", ctypes.c_void_p),
        ("pose", ctypes.c_void_p),
        ("sensor", ctypes.c_char_p),
        ("model", ctypes.c_char_p),
    )


class _Plane(ctypes.Structure):
    _fields_ = (
        ("name", ctypes.c_char_p),
        ("values", ctypes.c_void_p),
        ("bytes", ctypes.c_uint8),
        ("bits", ctypes.c_uint8),
        ("role", ctypes.c_uint8),
        ("of", ctypes.c_uint8),
    )


class _Field(ctypes.Structure):
    _fields_ = (
        ("name", ctypes.c_char_p),
        ("count", ctypes.c_uint32),
        ("type", ctypes.c_uint8),
        ("bytes", ctypes.c_uint8),
    )


class _Picture(ctypes.Structure):
    _fields_ = (
        ("data", ctypes.c_void_p),
        ("size", ctypes.c_size_t),
        ("rows", ctypes.c_uint32),
        ("width", ctypes.c_uint32),
        ("codec", ctypes.c_uint16),
        ("bits", ctypes.c_uint8),
        ("begins", ctypes.c_uint8),
    )


class Picture(NamedTuple):
    """A picture that the library asks a program to open."""

    data: bytes
    rows: int
    width: int
    bits: int
    begins: bool


Opens = Callable[[Picture], npt.NDArray[np.uint16]]
"""Opens a picture: (rows, width) samples. Raises SectionError if it cannot."""
_OPEN = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.POINTER(_Picture), ctypes.POINTER(ctypes.c_uint16))

TYPES = (None, "i1", "u1", "i2", "u2", "i4", "u4", "f4", "f8")
"""The type in numpy of each lidarcodec_type, by its number."""


class Decoded(NamedTuple):
    """A frame as the library gives it; shapes as in `Frame`. pose: (3, 4) or None; points: (N,) POINT, first
    returns or, as `all_points`, second ones too; forms: name, bits, role and `of` of each plane."""

    index: int
    stamp_ns: int
    sensor: str
    model: str
    range_step_m: float
    laser: npt.NDArray[np.uint8]
    planes: dict[str, npt.NDArray[np.unsignedinteger]]
    forms: list[tuple[str, int, int, int]]
    azimuth: npt.NDArray[np.uint16]
    fired: npt.NDArray[np.bool_]
    pose: npt.NDArray[np.float64] | None
    points: npt.NDArray[np.void]
    all_points: npt.NDArray[np.void]


class CSession:
    """A session of the library. Raises the errors of the package."""

    def __init__(self, library: Path) -> None:
        self._c = ctypes.CDLL(str(library))
        self._c.lidarcodec_open.restype = ctypes.c_void_p
        self._c.lidarcodec_error_text.restype = ctypes.c_char_p
        self._c.lidarcodec_error_offset.restype = self._c.lidarcodec_error_needs.restype = ctypes.c_uint64
        self._c.lidarcodec_points.restype = self._c.lidarcodec_fields.restype = ctypes.c_size_t
        self._c.lidarcodec_values.restype = ctypes.c_size_t
        self._c.lidarcodec_message.restype = ctypes.c_void_p
        self._session = ctypes.c_void_p(self._c.lidarcodec_open())
        self._opens: dict[int, Any] = {}

    def close(self) -> None:
        """Frees it."""
        self._c.lidarcodec_close(self._session)

    def give_weights(self, data: bytes | None) -> None:
        """A weight file that messages may name; None: a null pointer."""
        self._check(self._c.lidarcodec_give_weights(self._session, data, ctypes.c_size_t(len(data or b""))))

    def give_pictures(self, codec: int, opens: Opens | None) -> None:
        """What opens the pictures of a codec from now on."""

        def called(_: object, given: Any, samples: Any) -> int:
            asked = given[0]
            assert asked.codec == codec
            data = ctypes.string_at(asked.data, asked.size)
            try:
                image = opens(Picture(data, asked.rows, asked.width, asked.bits, bool(asked.begins)))  # type: ignore[misc]
            except SectionError:
                return 0
            np.ctypeslib.as_array(samples, image.shape)[:] = image
            return 1

        self._opens[codec] = _OPEN(called) if opens else _OPEN()
        self._check(self._c.lidarcodec_give_pictures(self._session, ctypes.c_uint16(codec), self._opens[codec], None))

    def push_unseen(self, data: bytes) -> None:
        """Decodes a message without taking its frame."""
        self._check(self._c.lidarcodec_push(self._session, data, ctypes.c_size_t(len(data)), None))

    def points(self) -> int:
        """How many points the frame that was pushed last has."""
        return int(self._c.lidarcodec_points(self._session, FIRST, None, ctypes.c_size_t(0)))

    def _points(self, returns: int) -> npt.NDArray[np.void]:
        count = self._c.lidarcodec_points(self._session, returns, None, ctypes.c_size_t(0))
        points = np.zeros(count, POINT)
        given = (points.ctypes.data_as(ctypes.c_void_p), ctypes.c_size_t(count))
        assert self._c.lidarcodec_points(self._session, returns, *given) == count
        return points

    def message(self) -> bytes | None:
        """The message of the point cloud that was pushed last; None of another frame."""
        size = ctypes.c_size_t()
        at = self._c.lidarcodec_message(self._session, ctypes.byref(size))
        return None if at is None else ctypes.string_at(at, size.value)

    def values(self, place: int) -> int:
        """How many values the field at a place has."""
        return int(self._c.lidarcodec_values(self._session, ctypes.c_size_t(place), None, ctypes.c_size_t(0)))

    def fields(self) -> list[tuple[str, npt.NDArray]]:
        """Names and values, (points, count) each, of the fields of that point cloud."""
        given = (_Field * self._c.lidarcodec_fields(self._session, None, ctypes.c_size_t(0)))()
        assert self._c.lidarcodec_fields(self._session, given, ctypes.c_size_t(len(given))) == len(given)
        found = []
        for place, one in enumerate(given):
            dtype = np.dtype(TYPES[one.type])
            assert one.bytes == dtype.itemsize
            count = self._c.lidarcodec_values(self._session, ctypes.c_size_t(place), None, ctypes.c_size_t(0))
            values = np.zeros(count, dtype)
            to = (values.ctypes.data_as(ctypes.c_void_p), ctypes.c_size_t(count))
            assert self._c.lidarcodec_values(self._session, ctypes.c_size_t(place), *to) == count
            found.append((one.name.decode("utf-8", "backslashreplace"), values.reshape(-1, max(one.count, 1))))
        return found

    def push(self, data: bytes | None) -> Decoded:
        """The frame of a message; None: a null pointer."""
        frame = _Frame()
        size = ctypes.c_size_t(len(data or b""))
        self._check(self._c.lidarcodec_push(self._session, data, size, ctypes.byref(frame)))
        return self._decoded(frame)

    def push_all(self, data: bytes) -> list[Decoded]:
        """The frames of a message."""
        found, frame = [self.push(data)], _Frame()
        while self._c.lidarcodec_next(self._session, ctypes.byref(frame)):
            found.append(self._decoded(frame))
        return found

    def next_unseen(self) -> bool:
        """Whether there is another frame of the message, which is the one that is asked about from now on."""
        return bool(self._c.lidarcodec_next(self._session, None))

    def _decoded(self, frame: _Frame) -> Decoded:
        shape = (frame.rows, frame.width)
        given = (_Plane * frame.plane_count).from_address(frame.planes) if frame.plane_count else ()
        planes = {one.name.decode(): _array(one.values, f"u{one.bytes}", shape) for one in given}
        return Decoded(
            frame.index,
            frame.stamp_ns,
            frame.sensor.decode(),
            frame.model.decode(),
            frame.range_step_m,
            _array(frame.laser, np.uint8, (frame.rows,)),
            planes,
            [(one.name.decode(), one.bits, one.role, one.of) for one in given],
            _array(frame.azimuth, np.uint16, (2, frame.width)),
            _array(frame.fired, np.uint8, (2, frame.width)).astype(np.bool_),
            _array(frame.pose, np.float64, (3, 4)) if frame.pose else None,
            self._points(FIRST),
            self._points(ALL),
        )

    def _check(self, status: int) -> None:
        if not status:
            return
        text = self._c.lidarcodec_error_text(self._session).decode()
        error = ERRORS[status]
        number = self._c.lidarcodec_error_needs if status == 6 else self._c.lidarcodec_error_offset
        raise error(text, number(self._session))


def _array(at: int | None, dtype: npt.DTypeLike, shape: tuple[int, ...]) -> npt.NDArray:
    size = int(np.prod(shape)) * np.dtype(dtype).itemsize
    return np.frombuffer(ctypes.string_at(at or 0, size) if size else b"", dtype).reshape(shape).copy()

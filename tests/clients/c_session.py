"""The C library (native/include/lidarcodec.h) by ctypes, as a decoder of streams for tests."""

from __future__ import annotations

import ctypes
from pathlib import Path
from typing import NamedTuple

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

ROWS = 64
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
    [("x", "f4"), ("y", "f4"), ("z", "f4"), ("intensity", "u1"), ("laser", "u1"), ("ring", "u1"), ("_", "u1")]
)


class _Frame(ctypes.Structure):
    _fields_ = (
        ("stream_id", ctypes.c_uint64),
        ("index", ctypes.c_uint64),
        ("stamp_ns", ctypes.c_int64),
        ("codec", ctypes.c_uint16),
        ("key", ctypes.c_uint8),
        ("has_intensity", ctypes.c_uint8),
        ("width", ctypes.c_uint32),
        ("points", ctypes.c_uint32),
        ("range_step_m", ctypes.c_double),
        ("range", ctypes.c_void_p),
        ("intensity", ctypes.c_void_p),
        ("azimuth", ctypes.c_void_p),
        ("fired", ctypes.c_void_p),
        ("laser", ctypes.c_void_p),
        ("pose", ctypes.c_void_p),
        ("sensor", ctypes.c_char_p),
    )


class Decoded(NamedTuple):
    """A frame as the library gives it; shapes as in `Frame`. pose: (3, 4) or None; points: (N,) POINT."""

    index: int
    stamp_ns: int
    sensor: str
    range: npt.NDArray[np.uint16]
    intensity: npt.NDArray[np.uint8]
    azimuth: npt.NDArray[np.uint16]
    fired: npt.NDArray[np.bool_]
    pose: npt.NDArray[np.float64] | None
    points: npt.NDArray[np.void]


class CSession:
    """A session of the library. Raises the errors of the package."""

    def __init__(self, library: Path) -> None:
        self._c = ctypes.CDLL(str(library))
        self._c.lidarcodec_open.restype = ctypes.c_void_p
        self._c.lidarcodec_error_text.restype = ctypes.c_char_p
        self._c.lidarcodec_error_offset.restype = self._c.lidarcodec_error_needs.restype = ctypes.c_uint64
        self._c.lidarcodec_points.restype = ctypes.c_size_t
        self._session = ctypes.c_void_p(self._c.lidarcodec_open())

    def close(self) -> None:
        """Frees it."""
        self._c.lidarcodec_close(self._session)

    def give_weights(self, data: bytes | None) -> None:
        """A weight file that messages may name; None: a null pointer."""
        self._check(self._c.lidarcodec_give_weights(self._session, data, ctypes.c_size_t(len(data or b""))))

    def push_unseen(self, data: bytes) -> None:
        """Decodes a message without taking its frame."""
        self._check(self._c.lidarcodec_push(self._session, data, ctypes.c_size_t(len(data)), None))

    def points(self) -> int:
        """How many points the frame that was pushed last has."""
        return int(self._c.lidarcodec_points(self._session, None, ctypes.c_size_t(0)))

    def push(self, data: bytes | None) -> Decoded:
        """The frame of a message; None: a null pointer."""
        frame = _Frame()
        size = ctypes.c_size_t(len(data or b""))
        self._check(self._c.lidarcodec_push(self._session, data, size, ctypes.byref(frame)))
        points = np.zeros(frame.points, POINT)
        given = (points.ctypes.data_as(ctypes.c_void_p), ctypes.c_size_t(len(points)))
        assert self._c.lidarcodec_points(self._session, *given) == frame.points
        width = frame.width
        return Decoded(
            frame.index,
            frame.stamp_ns,
            frame.sensor.decode(),
            _array(frame.range, np.uint16, (ROWS, width)),
            _array(frame.intensity, np.uint8, (ROWS, width)),
            _array(frame.azimuth, np.uint16, (2, width)),
            _array(frame.fired, np.uint8, (2, width)).astype(np.bool_),
            _array(frame.pose, np.float64, (3, 4)) if frame.pose else None,
            points,
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

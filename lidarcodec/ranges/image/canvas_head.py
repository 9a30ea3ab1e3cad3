"""How a RANGE section says where the cells of a canvas are: flags u8, then column spacing of both blocks, u32 each."""

from __future__ import annotations

import struct
from typing import Final

import numpy as np
import numpy.typing as npt

from lidarcodec.errors import SectionError
from lidarcodec.frame import Frame
from lidarcodec.ranges.image.canvas import Canvas, spacing_of
from lidarcodec.sensor_model import SensorModel

Mask = npt.NDArray[np.bool_]

COMPACT: Final = 1
"""The only flag: empty columns of a block are left out."""
HEAD: Final = struct.Struct("<BII")


def canvas_of_frame(frame: Frame, valid: Mask, multiple: int = 1) -> tuple[bytes, Canvas]:
    """Head and canvas of a frame. valid: (64, W) bool, the returns that are sent."""
    compact = not frame.fired.all()
    spacing = spacing_of(frame.azimuth, frame.fired, frame.sensor)
    canvas = Canvas.of(frame.sensor, valid, spacing, compact=compact, multiple=multiple)
    return HEAD.pack(COMPACT if compact else 0, *spacing), canvas


def split_canvas(data: bytes, valid: Mask, sensor: SensorModel, multiple: int = 1) -> tuple[Canvas, bytes]:
    """Canvas of a section, and what follows its head.

    Raises SectionError.
    """
    if len(data) < HEAD.size:
        raise SectionError(f"a range section of {len(data)} bytes ends before its canvas is known")
    flags, upper, lower = HEAD.unpack_from(data)
    if flags & ~COMPACT:
        raise SectionError(f"a canvas with unknown flags {flags:#04x}")
    canvas = Canvas.of(sensor, valid, (upper, lower), compact=bool(flags & COMPACT), multiple=multiple)
    return canvas, data[HEAD.size :]

"""`png`: the range image as it is, holes filled along the rows, as a grey PNG of 16 bits. Lossless or with a bound.

What every image viewer opens; the lossless reference of the papers. Aligning rows gains nothing here: the filter that
suits ranges looks to the left. A RANGE section is the step u16 and, if there are returns, the PNG.
"""

from __future__ import annotations

import struct
import zlib
from typing import Final

import numpy as np
import numpy.typing as npt
from pydantic import Field

from lidarcodec.codecs.base import Codec, CodecSettings, InForce
from lidarcodec.codecs.frame_decoder import independent_decoder
from lidarcodec.codecs.frame_encoder import independent_encoder
from lidarcodec.codecs.pictures import picture_others
from lidarcodec.codecs.rate_knob import bound_knob
from lidarcodec.errors import LidarCodecError, SectionError
from lidarcodec.frame import Frame
from lidarcodec.ranges.image.holes import filled_left
from lidarcodec.ranges.image.range_cells import Numbers, RangeCells
from lidarcodec.ranges.quantise import quantise, reconstruct
from lidarcodec.ranges.steps import split_step, with_step
from lidarcodec.sensor_model import SensorModel

Ranges = npt.NDArray[np.uint16]
Mask = npt.NDArray[np.bool_]

_SIGNATURE: Final = b"\x89PNG\r\n\x1a\n"
_IHDR: Final = struct.Struct(">II5B")
_GREY_16: Final = (16, 0, 0, 0, 0)
"""16 bits, grey, deflate, the five standard filters, not interlaced."""
_SUB: Final = 1
_ONLY_SUB: Final = 16
"""libpng's name for the filter "sub" in all rows: the difference to the left. Rows of one sample get "none"."""


class PngSettings(CodecSettings):
    """Settings of `png`."""

    level: int = Field(default=4, ge=0, le=9)
    """Compression level of zlib."""


def write_png(image: Ranges, level: int) -> bytes:
    """The PNG of a (H, W) image. level: zlib's.

    Raises MemoryError, or LidarCodecError if libpng cannot write it.
    """
    import imagecodecs

    try:
        return bytes(imagecodecs.png_encode(image, level=level, filter=_ONLY_SUB))
    except imagecodecs.PngError as error:
        if "memory" in str(error):
            raise MemoryError(str(error)) from None
        raise LidarCodecError(f"libpng cannot write {image.shape[1]} x {image.shape[0]} samples: {error}") from None


def compressed_pixels(data: bytes, rows: int, width: int) -> bytes:
    """What the data parts of a PNG hold together, if it is grey, 16 bits, of these sides and has no other parts.

    Raises SectionError.
    """
    if data[:8] != _SIGNATURE:
        raise SectionError("a PNG that does not begin as one")
    at, parts = 8, []
    while at < len(data):
        size, kind = int.from_bytes(data[at : at + 4], "big"), data[at + 4 : at + 8]
        body = data[at + 8 : at + 8 + size]
        if len(data) < at + 12 + size:
            raise SectionError(f"a PNG that ends within its part at byte {at}")
        if zlib.crc32(body, zlib.crc32(kind)) != int.from_bytes(data[at + 8 + size : at + 12 + size], "big"):
            raise SectionError(f"a PNG whose part at byte {at} is damaged")
        parts.append((kind, body))
        at += 12 + size
    if not parts or parts[0] != (b"IHDR", _IHDR.pack(width, rows, *_GREY_16)):
        raise SectionError(f"a PNG that is not grey, 16 bits, {width} x {rows}")
    if parts[-1] != (b"IEND", b"") or any(kind != b"IDAT" for kind, _ in parts[1:-1]):
        raise SectionError("a PNG with other parts than header, data and end")
    return b"".join(body for _, body in parts[1:-1])


def read_png(data: bytes, rows: int, width: int) -> Ranges:
    """(rows, width) uint16 samples of a PNG whose rows have the filters none or sub.

    By zlib alone, told how much there is to come: libpng prints warnings about what it reads.
    Raises SectionError if it is damaged, or anything but that.
    """
    pixels, inflate = compressed_pixels(data, rows, width), zlib.decompressobj()
    size = rows * (1 + 2 * width)
    try:
        plain = inflate.decompress(pixels, size + 1)
    except zlib.error as error:
        raise SectionError(f"damaged PNG: {error}") from None
    if len(plain) != size or not inflate.eof or inflate.unused_data:
        raise SectionError("a PNG that is not what its header says")
    lines = np.frombuffer(plain, np.uint8).reshape(rows, 1 + 2 * width)
    image = np.zeros((rows, width, 2), np.uint8)
    for row, line in enumerate(lines):
        filtered, kind = line[1:].reshape(width, 2), int(line[0])
        if kind > _SUB:
            raise SectionError(f"a PNG with filter {kind} in row {row}: 0 and {_SUB} are read")
        image[row] = filtered.cumsum(axis=0, dtype=np.uint8) if kind == _SUB else filtered
    return image.view(">u2")[..., 0].astype(np.uint16)


def code_ranges(frame: Frame, settings: InForce[PngSettings]) -> bytes:
    """The RANGE section of a frame."""
    step = settings.stream.step
    if not frame.valid.any():
        return with_step(step, b"")
    filled = filled_left(quantise(frame.range_u16, step), frame.valid)
    return with_step(step, write_png(filled, settings.own.level))


def decode_ranges(data: bytes, valid: Mask, sensor: SensorModel) -> Ranges:
    """(N,) uint16, the ranges of a RANGE section. Raises SectionError."""
    step, png = split_step(data)
    if not valid.any():
        if png:
            raise SectionError(f"{len(png)} bytes of ranges for no return")
        return np.zeros(0, np.uint16)
    return reconstruct(read_png(png, *valid.shape)[valid], step)


def write_numbers(numbers: Numbers, cells: RangeCells, own: PngSettings) -> bytes:
    """The PNG of the lower 16 bits of range numbers of any sensor."""
    return write_png(filled_left(numbers.astype(np.uint16), cells.known), own.level)


def read_numbers(data: bytes, cells: RangeCells) -> Ranges:
    """(H, W) uint16, those bits. Raises SectionError."""
    return read_png(data, *cells.known.shape)


CODEC = Codec(
    PngSettings,
    independent_encoder(PngSettings, code_ranges),
    independent_decoder(decode_ranges),
    knob=bound_knob(),
    others=picture_others(PngSettings, write_numbers, read_numbers, exact=True),
)

"""Damaged image files and video pictures, straight to the functions that hand them to other people's decoders; PNG's
checksums made right.

The message around an image is right in all of these: nothing but the look at its own header stands before the decoder.
"""

from __future__ import annotations

import io
import random
import struct
import zlib
from collections.abc import Callable

import imagecodecs
import numpy as np
import PIL.Image

from lidarcodec.codecs.png import read_png
from lidarcodec.ranges.image.jpeg_file import read_jpeg, write_jpeg
from lidarcodec.ranges.image.jxl_file import read_jxl, write_jxl
from lidarcodec.ranges.video.h264_stream import PictureReader, PictureWriter
from lidarcodec.ranges.video.h264_units import split_units
from tests.fuzz.mutations import mutated

WIDTH = 96
RNG = np.random.default_rng(31)
SMOOTH = np.cumsum(RNG.integers(-9, 10, (64, WIDTH)), axis=1) + 3000
GREY = SMOOTH.astype(np.uint16)


def jpeg_of(image: np.ndarray, **options: object) -> bytes:
    """A JPEG by Pillow."""
    out = io.BytesIO()
    PIL.Image.fromarray(image).save(out, "jpeg", **options)
    return out.getvalue()


FOREIGN = [
    bytes(imagecodecs.jpegxl_encode(np.stack([GREY] * 4), lossless=True)),
    bytes(imagecodecs.jpegxl_encode((GREY >> 4).astype(np.uint8), lossless=False)),
    jpeg_of(np.zeros((64, WIDTH, 3), np.uint8)),
    jpeg_of((GREY >> 4).astype(np.uint8), progressive=True),
    bytes(imagecodecs.png_encode(np.dstack([GREY] * 3))),
]
"""What is an image, but not ours."""

Target = Callable[[random.Random], tuple[bytes, Callable[[bytes], object]]]


def _png(width: int, rows: int, kind: tuple[int, ...], pixels: bytes) -> bytes:
    """A PNG of right checksums around these compressed pixels."""
    out = b"\x89PNG\r\n\x1a\n"
    for name, body in ((b"IHDR", struct.pack(">II5B", width, rows, *kind)), (b"IDAT", pixels), (b"IEND", b"")):
        out += struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body))
    return out


def _png_case(rng: random.Random) -> bytes:
    rows = b"".join(bytes([rng.randrange(3 + (rng.random() < 0.05))]) + line.tobytes() for line in GREY.astype(">u2"))
    pixels = zlib.compress(mutated(rows, rng), 1) if rng.random() < 0.5 else mutated(zlib.compress(rows, 1), rng)
    if rng.random() < 0.2:
        return _png(rng.randrange(2**31), 64, (16, 0, 0, 0, rng.randrange(2)), pixels)
    return _png(WIDTH, 64, (16, 0, 0, 0, 0), pixels)


def _pictures(bits: int) -> list[tuple[bytes, bytes]]:
    """An IDR picture and a P picture after it, by preset."""
    found = []
    for preset in ("ultrafast", "fast"):
        writer = PictureWriter(64, WIDTH, bits, 12.0, preset)  # type: ignore[arg-type]
        picture = GREY >> (12 - bits)
        found.append((writer.write(picture, idr=True), writer.write(np.roll(picture, 5, axis=1), idr=False)))
    return found


def _damaged_units(data: bytes, rng: random.Random) -> bytes:
    """An access unit with damage in one NAL unit, so that its parts are still what they should be."""
    units = split_units(data)
    at = rng.randrange(len(units))
    damaged = bytearray(units[at])
    for _ in range(rng.randrange(1, 6)):
        damaged[rng.randrange(1, len(damaged))] = rng.randrange(256)
    if rng.random() < 0.2:
        del damaged[rng.randrange(2, len(damaged) + 1) :]
    units[at] = bytes(damaged)
    return b"".join(b"\0\0\1" + unit for unit in units)


def image_targets() -> dict[str, Target]:
    """A target for each kind of file."""
    jxl = [write_jxl(GREY, effort) for effort in (1, 2, 3, 7)]
    jpeg: dict[int, list[bytes]] = {}
    known = np.ones(GREY.shape, np.bool_)
    for bits in (8, 12):
        samples = (SMOOTH / (1 if bits == 12 else 16)).astype(np.float32)
        jpeg[bits] = [write_jpeg(samples, known, bits, tables, 90, 1.0) for tables in ("even", "libjpeg")]

    def png_target(rng: random.Random) -> tuple[bytes, Callable[[bytes], object]]:
        return _png_case(rng), lambda data: read_png(data, 64, WIDTH)

    def jxl_target(rng: random.Random) -> tuple[bytes, Callable[[bytes], object]]:
        return mutated(rng.choice([*jxl, *FOREIGN]), rng), lambda data: read_jxl(data, 64, WIDTH)

    def jpeg_target(rng: random.Random) -> tuple[bytes, Callable[[bytes], object]]:
        bits = rng.choice((8, 12))
        return mutated(rng.choice([*jpeg[bits], *FOREIGN]), rng), lambda data: read_jpeg(data, 64, WIDTH, bits)

    pictures = {bits: _pictures(bits) for bits in (8, 10)}

    def h264_target(rng: random.Random) -> tuple[bytes, Callable[[bytes], object]]:
        bits = rng.choice((8, 10))
        first, second = rng.choice(pictures[bits])
        damage = mutated if rng.random() < 0.2 else _damaged_units
        if rng.random() < 0.4:
            return damage(first, rng), lambda data: PictureReader(64, WIDTH, bits).read(data, idr=True)

        def after_another(data: bytes) -> object:
            reader = PictureReader(64, WIDTH, bits)
            reader.read(first, idr=True)
            return reader.read(data, idr=False)

        return damage(second, rng), after_another

    return {"h264 pictures": h264_target, "png files": png_target, "jxl files": jxl_target, "jpeg files": jpeg_target}

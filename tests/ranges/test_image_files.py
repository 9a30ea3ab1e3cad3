"""PNG, JPEG and JPEG XL files: what the library would decode too readily is refused by its header."""

from __future__ import annotations

import io
import struct
import zlib

import imagecodecs
import numpy as np
import PIL.Image
import pytest

from lidarcodec import _native
from lidarcodec.codecs.png import read_png, write_png
from lidarcodec.errors import SectionError, SettingsError
from lidarcodec.ranges.image.holes import filled_blocks, filled_left, filled_predicted
from lidarcodec.ranges.image.jpeg_file import read_jpeg, steps_of, write_jpeg
from lidarcodec.ranges.image.jxl_file import read_jxl, write_jxl

RNG = np.random.default_rng(21)
GREY = RNG.integers(0, 65536, (64, 40)).astype(np.uint16)
SMOOTH = (2000 + 900 * np.sin(np.arange(40) / 7) + 4 * np.arange(64)[:, None]).astype(np.float32)
ALL = np.ones(SMOOTH.shape, np.bool_)


def jpeg_of(image: np.ndarray, **options: object) -> bytes:
    """A JPEG by Pillow."""
    out = io.BytesIO()
    PIL.Image.fromarray(image).save(out, "jpeg", **options)
    return out.getvalue()


def png_with(*parts: tuple[bytes, bytes]) -> bytes:
    """A PNG of these parts, each with a right checksum."""
    out = b"\x89PNG\r\n\x1a\n"
    for kind, body in parts:
        out += struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
    return out


def header(width: int, height: int, *rest: int) -> tuple[bytes, bytes]:
    return b"IHDR", struct.pack(">II5B", width, height, *(rest or (16, 0, 0, 0, 0)))


DATA = (b"IDAT", zlib.compress(bytes(64 * 81)))
END = (b"IEND", b"")


def test_a_png_comes_back() -> None:
    np.testing.assert_array_equal(read_png(imagecodecs.png_encode(GREY, filter=16), 64, 40), GREY)
    assert not read_png(png_with(header(40, 64), DATA, END), 64, 40).any()


def test_both_filters_that_are_allowed_are_undone() -> None:
    lines = []
    for row, line in enumerate(GREY.astype(">u2").view(np.uint8).reshape(64, 40, 2)):
        left = np.vstack([np.zeros((1, 2), np.uint8), line[:-1]])
        lines.append(bytes([row % 2]) + (line - (0 * line, left)[row % 2]).tobytes())
    data = png_with(header(40, 64), (b"IDAT", zlib.compress(b"".join(lines))), END)
    np.testing.assert_array_equal(read_png(data, 64, 40), GREY)
    np.testing.assert_array_equal(imagecodecs.png_decode(data), GREY)


@pytest.mark.parametrize("width", [1, 2, 40])
def test_images_of_any_width_have_these_filters_alone(width: int) -> None:
    np.testing.assert_array_equal(read_png(write_png(GREY[:, :width].copy(), 4), 64, width), GREY[:, :width])


@pytest.mark.parametrize(
    "data",
    [
        b"",
        png_with(),
        png_with(header(2**31 - 1, 2**31 - 1), DATA, END),
        png_with(header(40, 65), DATA, END),
        png_with(header(40, 64, 16, 2, 0, 0, 0), DATA, END),
        png_with(header(40, 64, 16, 0, 0, 0, 1), DATA, END),
        png_with(header(40, 64, 8, 0, 0, 0, 0), DATA, END),
        png_with(header(40, 64), (b"zTXt", b"a\0\0" + zlib.compress(bytes(10**6))), DATA, END),
        png_with(header(40, 64), DATA),
        png_with(header(40, 64), (b"IDAT", zlib.compress(b"\2" * 64 * 81)), END),
        png_with(header(40, 64), (b"IDAT", zlib.compress(bytes(64 * 81 + 1))), END),
        png_with(header(40, 64), (b"IDAT", zlib.compress(bytes(64 * 81)) + b"more"), END),
        png_with(header(40, 64), (b"IDAT", zlib.compress(bytes(50))), END),
        png_with(header(40, 64), DATA, END)[:-3],
        png_with(header(40, 64), DATA, END) + b"\0",
        png_with(header(40, 64), DATA, END)[:60] + b"\xa5" + png_with(header(40, 64), DATA, END)[61:],
    ],
    ids=lambda data: f"{len(data)} bytes",
)
def test_a_png_that_is_anything_else_is_refused(data: bytes) -> None:
    with pytest.raises(SectionError):
        read_png(data, 64, 40)


@pytest.mark.parametrize("effort", [1, 2, 3])
@pytest.mark.parametrize("width", [1, 8, 40, 2264])
def test_a_codestream_comes_back(effort: int, width: int) -> None:
    image = RNG.integers(0, 65536, (64, width)).astype(np.uint16)
    np.testing.assert_array_equal(read_jxl(write_jxl(image, effort), 64, width), image)


def test_codestreams_of_any_width_come_back() -> None:
    """The header has three forms: sides in bits, in eights, and the width as one of seven ratios to the height."""
    for width in (*range(1, 300), 511, 512, 513, 2048, 8193, 25600):
        image = np.arange(64 * width, dtype=np.uint32).astype(np.uint16).reshape(64, width)
        np.testing.assert_array_equal(read_jxl(write_jxl(image, 1), 64, width), image)


def test_a_codestream_that_is_anything_else_is_refused() -> None:
    eight = imagecodecs.jpegxl_encode((GREY >> 8).astype(np.uint8), lossless=True)
    moving = imagecodecs.jpegxl_encode(np.stack([GREY] * 3), lossless=True)
    whole = imagecodecs.jpegxl_encode(GREY, lossless=True, effort=1)
    good = write_jxl(GREY, 1)
    for data in (b"", b"\xff\x0a", bytes(eight), bytes(moving), bytes(whole), good[:-20], good[2:], good[:9]):
        with pytest.raises(SectionError):
            read_jxl(data, 64, 40)
    for sides in ((64, 41), (63, 40), (64, 4000)):
        with pytest.raises(SectionError):
            read_jxl(good, *sides)


@pytest.mark.parametrize("bits", [8, 12])
@pytest.mark.parametrize("tables", ["even", "libjpeg"])
def test_a_jpeg_comes_back_nearly(bits: int, tables: str) -> None:
    samples = SMOOTH / np.float32(16 if bits == 8 else 1)
    for quality in (30, 90, 100):
        data = write_jpeg(samples, ALL, bits, tables, quality, 1.0)  # type: ignore[arg-type]
        came = read_jpeg(data, 64, 40, bits)
        error = np.sqrt(np.mean((came - samples.astype(np.float64)) ** 2))
        assert error < 0.5 * max(1, 16 * (5000 / quality if quality < 50 else 200 - 2 * quality) / 100), quality


def test_a_return_at_the_sensors_foot_can_be_sent() -> None:
    """Samples as fine as they get: steps that keep their metres would not fit a JPEG."""
    for quality in (1, 50, 100):
        steps = steps_of("even", quality, 66535.0)
        assert 1 <= steps[0] <= 65535


def test_our_jpeg_is_one_that_others_read() -> None:
    data = write_jpeg(SMOOTH / np.float32(16), ALL, 8, "even", 95, 1.0)
    other = np.asarray(PIL.Image.open(io.BytesIO(data)))
    np.testing.assert_array_equal(other, read_jpeg(data, 64, 40, 8))


@pytest.mark.parametrize("image", ["noise", "flat", "extreme", "one block", "steep"])
@pytest.mark.parametrize("step", [1, 7, 300, 65535])
@pytest.mark.parametrize("bits", [8, 12])
def test_any_image_makes_a_right_jpeg(image: str, step: int, bits: int) -> None:
    """Every symbol a block can have: long runs, the largest differences, all coefficients, none at all."""
    peak = (1 << bits) - 1
    samples = {
        "noise": RNG.uniform(0, peak, (64, 40)),
        "flat": np.full((64, 40), peak / 3),
        "extreme": np.where(RNG.random((64, 40)) < 0.5, 0, peak),
        "one block": RNG.uniform(0, peak, (8, 8)),
        "steep": np.kron(np.indices((8, 5)).sum(0) % 2 * peak, np.ones((8, 8))),
    }[image].astype(np.float32)
    data = _native.write_jpeg(samples, np.full(64, step, np.uint16), bits)
    came = read_jpeg(data, *samples.shape, bits)
    limit = 2 if step == 1 else 8 * step
    assert np.abs(came - samples).max() <= limit


def test_equal_steps_have_the_least_error_for_their_bits() -> None:
    rough = (SMOOTH + RNG.normal(0, 30, SMOOTH.shape)).astype(np.float32)

    def cost(tables: str, quality: int) -> tuple[float, int]:
        data = write_jpeg(rough, ALL, 12, tables, quality, 1.0)  # type: ignore[arg-type]
        return float(np.sqrt(np.mean((read_jpeg(data, 64, 40, 12) - rough) ** 2))), len(data)

    even = sorted(cost("even", quality) for quality in range(20, 96, 5))
    for quality in (50, 75, 90):
        error, size = cost("libjpeg", quality)
        assert np.interp(error, [e for e, _ in even], [s for _, s in even]) < size


def test_a_jpeg_that_is_anything_else_is_refused() -> None:
    good = write_jpeg(SMOOTH, ALL, 12, "even", 80, 1.0)
    at = good.index(b"\xff\xc1")
    colour = jpeg_of(np.zeros((64, 40, 3), np.uint8))
    slow = jpeg_of(np.zeros((64, 40), np.uint8), progressive=True)
    tall = good[: at + 5] + b"\xff\xf8" + good[at + 7 :]
    huge = good[: at + 5] + b"\xff\xff\xff\xff" + good[at + 9 :]
    twice = good[:at] + good[at : at + 13] + good[at:]
    for data in (b"", b"\xff\xd8", good[2:], good[:at], good[: at + 8], tall, huge, twice, good[:2] + b"\xff\xda\0\2"):
        with pytest.raises(SectionError):
            read_jpeg(data, 64, 40, 12)
    for data in (good, colour, slow):
        with pytest.raises(SectionError):
            read_jpeg(data, 64, 40, 8)
    with pytest.raises(SectionError):
        read_jpeg(good, 64, 48, 12)


def test_the_writer_refuses_what_no_jpeg_is() -> None:
    steps = np.ones(64, np.uint16)
    for samples, table, bits in (
        (np.zeros((64, 41), np.float32), steps, 12),
        (np.zeros((0, 40), np.float32), steps, 12),
        (SMOOTH, steps, 10),
        (SMOOTH, steps * 0, 12),
        (SMOOTH, steps[:63], 12),
    ):
        with pytest.raises(SettingsError):
            _native.write_jpeg(np.ascontiguousarray(samples), table, bits)
    with pytest.raises(SettingsError):
        _native.fill_blocks(SMOOTH, np.zeros((64, 39), np.uint8), steps, 3)


def test_filling_leaves_returns_alone_and_saves_bits() -> None:
    known = RNG.random(SMOOTH.shape) < 0.7
    known[24:40, 8:32] = False
    rough = np.where(known, SMOOTH + RNG.normal(0, 5, SMOOTH.shape), 0).astype(np.float32)
    steps = steps_of("even", 80, 1.0)
    filled = filled_blocks(rough, known, steps)
    np.testing.assert_array_equal(filled[known], rough[known])
    assert len(_native.write_jpeg(filled, steps, 12)) < len(_native.write_jpeg(rough, steps, 12)) * 0.7
    ranges = np.where(known, rough, 0).astype(np.uint16)
    for fill in (filled_left, filled_predicted):
        np.testing.assert_array_equal(fill(ranges, known)[known], ranges[known])
    nothing = np.zeros(SMOOTH.shape, np.bool_)
    assert np.isfinite(filled_blocks(rough, nothing, steps)).all()

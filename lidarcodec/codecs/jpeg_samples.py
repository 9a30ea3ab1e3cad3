"""Conversion between ranges and samples of a JPEG, for both JPEG codecs.

A RANGE section describes it by bits u8, mapping u8, and top u32, the canvas value of the largest sample.
"""

from __future__ import annotations

import struct
from typing import Final, Literal

import numpy as np
import numpy.typing as npt
from pydantic import Field

from lidarcodec.codecs.base import CodecSettings
from lidarcodec.errors import SectionError
from lidarcodec.ranges.image.jpeg_file import Tables, write_jpeg
from lidarcodec.ranges.mapping import CANVAS, NAMES, Scale, check_top, mapping_of, top_of

Ranges = npt.NDArray[np.uint16]
Mask = npt.NDArray[np.bool_]

SAMPLES: Final = struct.Struct("<BBI")
_MAPPINGS: Final = 3
"""Those of a JPEG are the first three."""


class JpegSettings(CodecSettings):
    """Settings of `jpeg`. `jpeg-layered` has further ones."""

    quality: float = Field(default=90, ge=1, le=100)
    """Quality as in libjpeg: higher is finer and larger. `tables=libjpeg` rounds it to a whole number."""
    bits: Literal[8, 12] = 12
    """Bits of each sample. 8 bits: steps of 0.3 m at 80 m, readable by decoders without 12-bit support."""
    mapping: Literal["linear", "sqrt", "log"] = "linear"
    """How ranges are mapped to samples. `sqrt` and `log` give near ranges finer steps."""
    tables: Tables = "even"
    """Quantisation tables. `even`: the same step for all coefficients. `libjpeg`: the tables of libjpeg."""


def with_samples(
    own: JpegSettings, values: npt.NDArray[np.int32], known: Mask, scale: Scale = CANVAS
) -> tuple[bytes, bytes]:
    """Description of the samples, and the JPEG. values: (H, W) int32, ranges on the scale, 0 where not known."""
    top = top_of(own.mapping, int(values.max()), scale)
    table = mapping_of(own.mapping, own.bits, top, scale.step_um).sample
    samples = table.take(values)  # NumPy's indexing crashes if memory is short
    jpeg = write_jpeg(samples, known, own.bits, own.tables, own.quality, scale.finer(top))
    return SAMPLES.pack(own.bits, NAMES.index(own.mapping), top), jpeg


def split_samples(data: bytes, scale: Scale = CANVAS) -> tuple[int, npt.NDArray[np.int32], bytes]:
    """Bits a sample, canvas value of each sample, and what follows the description.

    Raises SectionError.
    """
    if len(data) < SAMPLES.size:
        raise SectionError(f"a range section of {len(data)} bytes ends before its samples are known")
    bits, mapping, top = SAMPLES.unpack_from(data)
    if bits not in (8, 12) or mapping >= _MAPPINGS:
        raise SectionError(f"samples of {bits} bits by mapping {mapping}")
    return bits, mapping_of(NAMES[mapping], bits, check_top(top, scale.most), scale.step_um).value, data[SAMPLES.size :]


def ranges_of(values: npt.NDArray[np.int32], offsets: npt.NDArray[np.int32], valid: Mask) -> Ranges:
    """(N,) uint16, ranges of the returns in row order: never 0, which means no return.

    values: (64, W), on the canvas' scale; offsets: (64,), what was added to each row.
    """
    near: Ranges = np.clip(values - offsets[:, None], 1, 65535).astype(np.uint16)[valid]
    return near

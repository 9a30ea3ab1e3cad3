"""`pcodec`: differences of consecutive returns of each row, in groups by activity, in the numerical codec pcodec (pco).

The default: 3 ms to write and 1 ms to read the ranges of a frame, lossless or with a bound.

A RANGE section is the step u16, and if there are returns: number of groups u8, for each group its first activity u8 and
its returns u32, then a pco file in pco's wrapped form: header, and for each group chunk metadata and one page of u16.
"""

from __future__ import annotations

import struct
from typing import Final

import numpy as np
import numpy.typing as npt
from pcodec import ChunkConfig, DeltaSpec, ModeSpec, PagingSpec, wrapped
from pydantic import Field

from lidarcodec.codecs.base import Codec, CodecSettings, InForce
from lidarcodec.codecs.frame_decoder import SessionDecoder
from lidarcodec.codecs.frame_encoder import independent_encoder
from lidarcodec.codecs.rate_knob import bound_knob
from lidarcodec.frame import Frame
from lidarcodec.ranges.activity import Groups
from lidarcodec.ranges.quantise import quantise
from lidarcodec.ranges.steps import with_step

Ranges = npt.NDArray[np.uint16]

_GROUP: Final = struct.Struct("<BI")


class PcodecSettings(CodecSettings):
    """Settings of `pcodec`."""

    level: int = Field(default=8, ge=1, le=12)
    """Compression level of pcodec. 12 saves 0.3 % compared with 8."""
    mask_history: bool = False
    """Whether masks are coded as changes of an earlier mask. Messages get a little smaller, but need earlier ones."""


def _config(level: int, count: int) -> ChunkConfig:
    """Configuration of pco for a chunk of `count` numbers in one page. By default pco begins a new page after 262,144
    numbers."""
    one_page = PagingSpec.exact_page_sizes([count])
    return ChunkConfig(level, mode_spec=ModeSpec.classic(), delta_spec=DeltaSpec.no_op(), paging_spec=one_page)


def compress_groups(values: Ranges, level: int) -> bytes:
    """Group table and pco data of (N,) uint16 values, N > 0."""
    groups = Groups.of(values)
    pco = wrapped.FileCompressor()
    parts = [bytes([len(groups.starts)])]
    parts += [_GROUP.pack(start, count) for start, count in zip(groups.starts, groups.counts, strict=True)]
    parts.append(pco.write_header())
    for differences in groups.split(values):
        chunk = pco.chunk_compressor(differences.view(np.int16), _config(level, len(differences)))
        parts += (chunk.write_meta(), chunk.write_page(0))
    return b"".join(parts)


def code_ranges(frame: Frame, settings: InForce[PcodecSettings]) -> bytes:
    """The RANGE section of a frame."""
    step = settings.stream.step
    returns = quantise(frame.range_u16[frame.valid], step)
    return with_step(step, compress_groups(returns, settings.own.level) if len(returns) else b"")


CODEC = Codec(
    PcodecSettings,
    independent_encoder(PcodecSettings, code_ranges, mask_history=lambda own: own.mask_history, layered=True),
    SessionDecoder,
    knob=bound_knob(),
    layered=True,
    parts=True,
)

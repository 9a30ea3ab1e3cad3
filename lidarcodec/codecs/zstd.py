"""`zstd`: differences along each row, zigzag, low bytes apart from high bytes, one zstd frame.

Needs no code of ours beyond NumPy. 1 ms a frame.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from pydantic import Field

from lidarcodec.codecs.base import Codec, CodecSettings, InForce
from lidarcodec.codecs.frame_decoder import SessionDecoder
from lidarcodec.codecs.frame_encoder import independent_encoder
from lidarcodec.codecs.rate_knob import bound_knob
from lidarcodec.entropy.zstd_frames import compress
from lidarcodec.frame import Frame
from lidarcodec.ranges.quantise import quantise
from lidarcodec.ranges.steps import with_step

Ranges = npt.NDArray[np.uint16]


class ZstdSettings(CodecSettings):
    """Settings of `zstd`."""

    level: int = Field(default=3, ge=1, le=19)
    """Compression level of zstd. 3 takes 1 ms a frame, 19 more than 100 ms."""


def folded_differences(values: Ranges) -> bytes:
    """Differences of consecutive values, modulo 65536, folded to 0 -1 1 -2 2 ...: all low bytes, then all high."""
    change = np.diff(values, prepend=np.uint16(0)).view(np.int16)
    folded = ((change << 1) ^ (change >> 15)).view(np.uint16)
    return (folded & 0xFF).astype(np.uint8).tobytes() + (folded >> 8).astype(np.uint8).tobytes()


def code_ranges(frame: Frame, settings: InForce[ZstdSettings]) -> bytes:
    """The RANGE section of a frame."""
    step = settings.stream.step
    return with_step(
        step, compress(folded_differences(quantise(frame.range_u16[frame.valid], step)), settings.own.level)
    )


CODEC = Codec(
    ZstdSettings,
    independent_encoder(ZstdSettings, code_ranges, grouped_intensity=True),
    SessionDecoder,
    knob=bound_knob(),
)

"""`h264`: range images on the canvas of a turn as 10-bit H.264 video (Tu 2016's "normal MPEG", which had 8 bits)."""

from __future__ import annotations

from typing import Literal

from lidarcodec.codecs.base import Codec
from lidarcodec.codecs.rate_knob import crf_knob
from lidarcodec.codecs.video import VideoDecoder, VideoEncoder, VideoSettings


class H264Settings(VideoSettings):
    """Settings of `h264`."""

    mapping: Literal["linear", "sqrt"] = "linear"
    """How ranges become samples (range_mapping.py)."""


class H264Encoder(VideoEncoder):
    """Encoder of `h264`."""

    model = H264Settings


KNOB = crf_knob(
    (
        (51, 0.0111),
        (48, 0.0176),
        (45, 0.0287),
        (42, 0.0474),
        (39, 0.0749),
        (36, 0.109),
        (33, 0.154),
        (30, 0.21),
        (27, 0.282),
        (24, 0.369),
        (21, 0.478),
        (18, 0.602),
        (15, 0.751),
        (12, 0.914),
        (9, 1.1),
        (6, 1.32),
        (3, 1.58),
        (0, 1.89),
    ),
    renewal=1.15,
)
"""Bits of a return's range, mean of two drives (benchmarks/rate_traces.py)."""

CODEC = Codec(H264Settings, H264Encoder, VideoDecoder, bounded=False, knob=KNOB, isolated=True)

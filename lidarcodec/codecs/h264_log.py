"""`h264-log`: as `h264`, but the logarithm of ranges is sent (Tu 2016's "log MPEG"): near returns are more exact."""

from __future__ import annotations

from typing import Literal

from lidarcodec.codecs.base import Codec
from lidarcodec.codecs.rate_knob import crf_knob
from lidarcodec.codecs.video import VideoDecoder, VideoEncoder, VideoSettings


class H264LogSettings(VideoSettings):
    """Settings of `h264-log`."""

    mapping: Literal["log", "paper"] = "log"
    """`log` fills the sample range; `paper` is the equation of Tu 2016 as printed (range_mapping.py)."""


class H264LogEncoder(VideoEncoder):
    """Encoder of `h264-log`."""

    model = H264LogSettings


KNOB = crf_knob(
    (
        (51, 0.0118),
        (48, 0.0189),
        (45, 0.0315),
        (42, 0.0529),
        (39, 0.0838),
        (36, 0.123),
        (33, 0.175),
        (30, 0.241),
        (27, 0.326),
        (24, 0.428),
        (21, 0.553),
        (18, 0.696),
        (15, 0.865),
        (12, 1.05),
        (9, 1.28),
        (6, 1.55),
        (3, 1.88),
        (0, 2.27),
    ),
    renewal=1.15,
)
"""Bits of a return's range, mean of two drives (benchmarks/rate_traces.py)."""

CODEC = Codec(H264LogSettings, H264LogEncoder, VideoDecoder, bounded=False, knob=KNOB, isolated=True)

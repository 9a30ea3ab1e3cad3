"""`h264-log`: as `h264`, but the logarithm of ranges is sent (Tu 2016's "log MPEG"): near returns are more exact."""

from __future__ import annotations

from typing import Literal

from lidarcodec.codecs.base import Codec
from lidarcodec.codecs.rate_knob import crf_knob
from lidarcodec.codecs.video import VideoDecoder, VideoEncoder, VideoSettings


class H264LogSettings(VideoSettings):
    """Settings of `h264-log`."""

    mapping: Literal["log", "paper"] = "log"
    """How ranges are mapped to samples. `log` uses the whole sample range. `paper` is the equation of Tu 2016."""


class H264LogEncoder(VideoEncoder):
    """Encoder of `h264-log`."""

    model = H264LogSettings


KNOB = crf_knob(renewal=1.15)

CODEC = Codec(H264LogSettings, H264LogEncoder, VideoDecoder, bounded=False, knob=KNOB, isolated=True, rolling=False)

"""`h264-log`: as `h264`, but the logarithm of ranges is sent (Tu 2016's "log MPEG"): near returns are more exact."""

from __future__ import annotations

from typing import Literal

from lidarcodec.codecs.base import Codec
from lidarcodec.codecs.rate_knob import crf_knob
from lidarcodec.codecs.video import VideoDecoder, VideoSettings, video_encoder, video_others


class H264LogSettings(VideoSettings):
    """Settings of `h264-log`."""

    mapping: Literal["log", "paper"] = "log"
    """How ranges are mapped to samples. `log` uses the whole sample range. `paper` is the equation of Tu 2016."""


CODEC = Codec(
    H264LogSettings,
    video_encoder(H264LogSettings),
    VideoDecoder,
    bounded=False,
    knob=crf_knob(renewal=1.15),
    isolated=True,
    rolling=False,
    others=video_others(H264LogSettings),
)

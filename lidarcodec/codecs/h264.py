"""`h264`: range images on the canvas of a turn as 10-bit H.264 video (Tu 2016's "normal MPEG", which had 8 bits)."""

from __future__ import annotations

from typing import Literal

from lidarcodec.codecs.base import Codec
from lidarcodec.codecs.rate_knob import crf_knob
from lidarcodec.codecs.video import VideoDecoder, VideoSettings, video_encoder, video_others


class H264Settings(VideoSettings):
    """Settings of `h264`."""

    mapping: Literal["linear", "sqrt", "log"] = "linear"
    """How ranges are mapped to samples. `sqrt` and `log` give near ranges finer steps."""


CODEC = Codec(
    H264Settings,
    video_encoder(H264Settings),
    VideoDecoder,
    bounded=False,
    # Chamfer distances are shorter with logarithms, root mean square errors are smaller without.
    knob=crf_knob(renewal=1.15, mapping="log"),
    isolated=True,
    rolling=False,
    others=video_others(H264Settings),
)

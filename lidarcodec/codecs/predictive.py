"""`predictive`: what is likely is learned while coding, from the returns around each return. No weights, any sensor.

Half a bit to two thirds of a bit a return less than `pcodec`, and twice the time: 6.1 bits lossless, 2.8 within a
centimetre, 1.5 within five on KITTI, about 10 ms each way. With `memory`, on by default, a frame goes on from what the
one before taught, which saves 0.06 bit, and masks refer to those of the last turn; a lost message then costs all frames
up to the next key frame.

A RANGE section is the step u16, then the bytes of docs/wire-format-predictive.md. A message that needs no other begins
from nothing; one that does goes on from where that left off.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from lidarcodec import entropy
from lidarcodec.codecs.base import Codec, CodecSettings, own_settings
from lidarcodec.codecs.canvas import level_offsets
from lidarcodec.codecs.intra import IntraDecoder, IntraEncoder
from lidarcodec.codecs.planes import Planes
from lidarcodec.codecs.range_steps import split_step, with_step
from lidarcodec.codecs.rate_knob import bound_knob
from lidarcodec.errors import LidarCodecError
from lidarcodec.frame import Frame
from lidarcodec.message import Message, Section, SectionType
from lidarcodec.sensor_model import SensorModel
from lidarcodec.settings import StreamSettings

Ranges = npt.NDArray[np.uint16]
Mask = npt.NDArray[np.bool_]


class PredictiveSettings(CodecSettings):
    """Settings of `predictive`."""

    memory: bool = True
    """Whether a frame goes on from what those since the last key frame taught: smaller, but then it needs them."""


class PredictiveEncoder(IntraEncoder):
    """Encoder of `predictive`."""

    def __init__(self, codec_id: int, settings: StreamSettings, stream_id: int) -> None:
        super().__init__(codec_id, settings, stream_id)
        self._coder = entropy.PredictiveCoder()

    def _mask_history(self) -> bool:
        return own_settings(PredictiveSettings, self.settings).memory

    def _sections(self, frame: Frame, key: bool) -> tuple[list[Section], int | None]:
        if key or self._history is None or not self._mask_history():
            self._coder.reset()
        try:
            return super()._sections(frame, key)
        except LidarCodecError:
            self._history = None  # what the frame taught no decoder learns
            raise

    def _range(self, frame: Frame, valid: Mask) -> bytes:
        step = self.settings.step
        turn = entropy.columns_in_turn(frame.azimuth) if frame.fired.all() else None
        levels = level_offsets(frame.sensor)
        return with_step(
            step, self._coder.encode(frame.range, valid, frame.fired, frame.sensor, step, levels, turn=turn)
        )


class PredictiveDecoder(IntraDecoder):
    """Decoder of `predictive`."""

    def __init__(self, codec_id: int) -> None:
        super().__init__(codec_id)
        self._coder = entropy.PredictiveCoder()

    def _ranges(self, message: Message, planes: Planes, sensor: SensorModel) -> Ranges:
        if message.needs is None:
            self._coder.reset()
        self._last = None  # a message that fails halfway has taught something else than its encoder learned
        step, data = split_step(message.section(SectionType.RANGE))
        return self._coder.decode(data, planes.valid, planes.fired, sensor, step, level_offsets(sensor))


KNOB = bound_knob(
    (
        (20, 0.055),
        (10, 0.091),
        (5, 0.147),
        (2.5, 0.213),
        (1, 0.369),
        (0.5, 0.536),
        (0.25, 0.753),
        (0.1, 1.19),
        (0.05, 1.66),
        (0.02, 2.45),
        (0.01, 3.18),
        (0.004, 4.23),
        (0.002, 4.96),
        (0, 6.55),
    )
)
"""Bits of a return's range, mean of two drives (benchmarks/rate_traces.py)."""

CODEC = Codec(PredictiveSettings, PredictiveEncoder, PredictiveDecoder, knob=KNOB)

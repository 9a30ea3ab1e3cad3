"""`predictive`: what is likely is learned while coding, from the returns around each return. No weights, any sensor.

Half a bit to two thirds of a bit a return less than `pcodec`, and twice the time: 6.1 bits lossless, 2.8 within a
centimetre, 1.5 within five on KITTI, about 10 ms each way. With `memory`, on by default, a frame goes on from what the
one before taught, which saves 0.06 bit, and masks refer to those of the last turn; a lost message then costs all frames
up to the next key frame.

With `motion` it also expects what the sensor saw a turn ago, moved as the sensor moved since: 0.1 to 0.2 bit less, for
20 ms more to encode (10 of them to find the motion where frames have no poses) and 10 to decode.

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
from lidarcodec.codecs.motion import decode_motion, encode_motion
from lidarcodec.codecs.motion_finder import MotionFinder
from lidarcodec.codecs.planes import Planes
from lidarcodec.codecs.range_steps import split_step, with_step
from lidarcodec.codecs.rate_knob import bound_knob
from lidarcodec.codecs.warp import RangeHistory
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
    motion: bool = False
    """Whether it also expects what was seen a turn ago, moved as the sensor moved; only with `memory`."""

    @property
    def expects(self) -> bool:
        """Whether frames are told what to expect."""
        return self.memory and self.motion


def as_decoded(ranges: Ranges, valid: Mask, step: int, sensor: SensorModel) -> Ranges:
    """(64, W) uint16, the ranges that a decoder gets, 0 outside of `valid`."""
    if step == 1:
        return np.where(valid, ranges, 0).astype(np.uint16)
    levels = level_offsets(sensor)[:, None]
    cells = (ranges.astype(np.int32) + (levels + step // 2)) // np.int32(step)
    return np.where(valid, (cells * np.int32(step) - levels).clip(1, 65535), 0).astype(np.uint16)


class PredictiveEncoder(IntraEncoder):
    """Encoder of `predictive`."""

    def __init__(self, codec_id: int, settings: StreamSettings, stream_id: int) -> None:
        super().__init__(codec_id, settings, stream_id)
        self._coder = entropy.PredictiveCoder()
        self._seen = RangeHistory()
        self._finder: MotionFinder | None = None
        self._expected: Ranges | None = None

    def apply(self, settings: StreamSettings) -> bool:
        """Takes new settings; a frame that is to expect something for the first time begins from nothing."""
        due = super().apply(settings)
        if not own_settings(PredictiveSettings, settings).expects:
            self._finder = None
        elif self._finder is None:
            self._history = None
        return due

    def _mask_history(self) -> bool:
        return own_settings(PredictiveSettings, self.settings).memory

    def _sections(self, frame: Frame, key: bool) -> tuple[list[Section], int | None]:
        fresh = key or self._history is None or not self._mask_history()
        try:
            motion = self._expect(frame, fresh)
            sections, needs = super()._sections(frame, key)
            if self._finder is not None:
                sent = as_decoded(frame.range, frame.valid, self.settings.step, frame.sensor)
                self._seen.remember(sent, frame.azimuth, frame.fired, frame.sensor)
        except LidarCodecError:
            self._history = None  # what the frame taught no decoder learns
            raise
        return sections + motion, needs

    def _expect(self, frame: Frame, fresh: bool) -> list[Section]:
        """Work out what to expect, unless the frame begins from nothing; the MOTION section that says so."""
        self._expected, motion = None, None
        if own_settings(PredictiveSettings, self.settings).expects:
            self._finder = self._finder or MotionFinder()
            motion = self._finder.next(frame, self._seen).motion
        if fresh:
            self._coder.reset()
            self._seen.forget()
            return []
        if motion is None:
            return []
        self._expected = self._seen.expected(motion, frame.azimuth, frame.fired, frame.sensor)
        return [Section(SectionType.MOTION, encode_motion(motion))]

    def _range(self, frame: Frame, valid: Mask) -> bytes:
        step = self.settings.step
        turn = entropy.columns_in_turn(frame.azimuth) if frame.fired.all() else None
        levels, expected = level_offsets(frame.sensor), self._expected
        given = (frame.range, valid, frame.fired, frame.sensor, step, levels)
        return with_step(step, self._coder.encode(*given, turn=turn, expected=expected))


class PredictiveDecoder(IntraDecoder):
    """Decoder of `predictive`."""

    def __init__(self, codec_id: int) -> None:
        super().__init__(codec_id)
        self._coder = entropy.PredictiveCoder()
        self._seen = RangeHistory()

    def _ranges(self, message: Message, planes: Planes, sensor: SensorModel) -> Ranges:
        if message.needs is None:
            self._coder.reset()
            self._seen.forget()
        self._last = None  # a message that fails halfway has taught something else than its encoder learned
        step, data = split_step(message.section(SectionType.RANGE))
        expected = None
        if message.has(SectionType.MOTION):
            motion = decode_motion(message.section(SectionType.MOTION))
            expected = self._seen.expected(motion, planes.azimuth, planes.fired, sensor)
        given = (planes.valid, planes.fired, sensor, step, level_offsets(sensor))
        ranges = self._coder.decode(data, *given, expected=expected)
        self._seen.remember(ranges, planes.azimuth, planes.fired, sensor)
        return ranges


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

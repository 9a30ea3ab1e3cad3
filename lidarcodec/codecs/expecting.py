"""Encoder and decoder of codecs whose ranges refer to what was sent since the last key frame (`StreamHistory`).

A codec adds how it writes ranges, with or without an image of what to expect: the ranges of a turn ago, moved as the
sensor moved since. The encoder finds that motion and sends it in a section of its own; a message without one expects
nothing. A frame that begins from nothing never expects anything.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import Final

import numpy as np
import numpy.typing as npt

from lidarcodec.codecs.canvas import level_offsets
from lidarcodec.codecs.history import Memory, StreamHistory
from lidarcodec.codecs.intra import IntraDecoder, IntraEncoder
from lidarcodec.codecs.motion import decode_motion, encode_motion
from lidarcodec.codecs.motion_finder import MotionFinder
from lidarcodec.codecs.planes import Planes
from lidarcodec.errors import LidarCodecError
from lidarcodec.frame import Frame
from lidarcodec.message import Message, Section, SectionType
from lidarcodec.sensor_model import SensorModel
from lidarcodec.settings import StreamSettings

Ranges = npt.NDArray[np.uint16]
Mask = npt.NDArray[np.bool_]


def as_decoded(ranges: Ranges, valid: Mask, step: int, sensor: SensorModel) -> Ranges:
    """(64, W) uint16, the ranges that a decoder gets, 0 outside of `valid`."""
    if step == 1:
        return np.where(valid, ranges, 0).astype(np.uint16)
    levels = level_offsets(sensor)[:, None]
    cells = (ranges.astype(np.int32) + (levels + step // 2)) // np.int32(step)
    return np.where(valid, (cells * np.int32(step) - levels).clip(1, 65535), 0).astype(np.uint16)


class ExpectingEncoder(IntraEncoder):
    """The encoder of such a codec. memory: what its coder of ranges learns."""

    def __init__(self, codec_id: int, settings: StreamSettings, stream_id: int, memory: Memory) -> None:
        super().__init__(codec_id, settings, stream_id)
        self._sent: Final = StreamHistory(memory)
        self._finder: MotionFinder | None = None
        self._expected: Ranges | None = None

    @abstractmethod
    def _remembers(self) -> bool:
        """Whether frames refer to those before."""

    @abstractmethod
    def _expects(self) -> bool:
        """Whether frames are told what to expect; only where they refer to those before."""

    @abstractmethod
    def _coded(self, frame: Frame, valid: Mask, expected: Ranges | None) -> bytes:
        """The RANGE section. valid: (64, W) bool, the returns that are sent; expected: (64, W) uint16, 0 = nothing."""

    def apply(self, settings: StreamSettings) -> bool:
        """Takes new settings; a frame that is to expect something for the first time begins from nothing."""
        due = super().apply(settings)
        if not self._expects():
            self._finder = None
        elif self._finder is None:
            self._history = None
        return due

    def _mask_history(self) -> bool:
        return self._remembers()

    def _sections(self, frame: Frame, key: bool) -> tuple[list[Section], int | None]:
        fresh = key or self._history is None or not self._remembers()
        try:
            motion = self._expect(frame, fresh)
            sections, needs = super()._sections(frame, key)
            if self._finder is not None:
                sent = as_decoded(frame.range, frame.valid, self.settings.step, frame.sensor)
                self._sent.remember(sent, frame.azimuth, frame.fired, frame.sensor)
        except LidarCodecError:
            self._history = None  # what the frame taught no decoder learns
            raise
        return sections + motion, needs

    def _expect(self, frame: Frame, fresh: bool) -> list[Section]:
        """Work out what to expect, unless the frame begins from nothing; the MOTION section that says so."""
        self._expected, motion = None, None
        if self._expects():
            self._finder = self._finder or MotionFinder()
            motion = self._finder.next(frame, self._sent.seen).motion
        if fresh:
            self._sent.forget()
            return []
        if motion is None:
            return []
        self._expected = self._sent.expected(motion, frame.azimuth, frame.fired, frame.sensor)
        return [Section(SectionType.MOTION, encode_motion(motion))]

    def _range(self, frame: Frame, valid: Mask) -> bytes:
        return self._coded(frame, valid, self._expected)


class ExpectingDecoder(IntraDecoder):
    """The decoder of such a codec. memory: what its coder of ranges learns."""

    def __init__(self, codec_id: int, memory: Memory) -> None:
        super().__init__(codec_id)
        self._sent: Final = StreamHistory(memory)

    @abstractmethod
    def _decoded(self, data: bytes, planes: Planes, sensor: SensorModel, expected: Ranges | None) -> Ranges:
        """(64, W) uint16 of a RANGE section, not 0 where `planes.valid`, 0 elsewhere; expected: as it was coded with.

        Raises SectionError.
        """

    def _ranges(self, message: Message, planes: Planes, sensor: SensorModel) -> Ranges:
        if message.needs is None:
            self._sent.forget()
        self._last = None  # a message that fails halfway has taught something else than its encoder learned
        expected = None
        if message.has(SectionType.MOTION):
            motion = decode_motion(message.section(SectionType.MOTION))
            expected = self._sent.expected(motion, planes.azimuth, planes.fired, sensor)
        ranges = self._decoded(message.section(SectionType.RANGE), planes, sensor, expected)
        self._sent.remember(ranges, planes.azimuth, planes.fired, sensor)
        return ranges

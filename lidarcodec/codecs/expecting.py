"""Encoder and decoder of codecs whose ranges refer to what was sent since the last key frame (`StreamHistory`).

A codec adds how it writes ranges, with or without an image of what to expect: the ranges of a turn ago, moved as the
sensor moved since. The encoder finds that motion and sends it in a section of its own; a message without one expects
nothing. A frame that begins from nothing never expects anything.

A frame of less than half a turn is a *slab*: it goes on where the slab before ended, with the columns there (*edge*) as
if they were its own, and with the motion of the message before where that is still the best one known.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import Final

import numpy as np
import numpy.typing as npt

from lidarcodec.codecs.intra import IntraDecoder, IntraEncoder
from lidarcodec.entropy import KnownColumns, MaskStream
from lidarcodec.errors import SectionError
from lidarcodec.frame import Frame
from lidarcodec.message import Message, Section, SectionType
from lidarcodec.motion.finder import MotionFinder
from lidarcodec.motion.history import Memory, StreamHistory
from lidarcodec.motion.motion import Motion, decode_motion, encode_motion
from lidarcodec.motion.warp import beam_rows, swept
from lidarcodec.planes.sections import DecodeMask, EncodeMask, Planes
from lidarcodec.ranges.firings import FiringCounter
from lidarcodec.ranges.image.canvas import level_offsets
from lidarcodec.sensor_model import SensorModel
from lidarcodec.settings import StreamSettings
from lidarcodec.units import AZIMUTH_TURN

Ranges = npt.NDArray[np.uint16]
Mask = npt.NDArray[np.bool_]


def as_decoded(ranges: Ranges, valid: Mask, step: int, sensor: SensorModel) -> Ranges:
    """(64, W) uint16, the ranges that a decoder gets of rounded ones, 0 outside of `valid`."""
    if step == 1:
        return np.where(valid, ranges, np.uint16(0))
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
        self._motion: Motion | None = None
        self._masks: Final = MaskStream()
        self._firings: Final = FiringCounter()
        self._slab = False
        self._free: Ranges | None = None  # free ranges of the frame at hand, as a decoder gets them

    @abstractmethod
    def _remembers(self) -> bool:
        """Whether frames refer to those before."""

    @abstractmethod
    def _expects(self) -> bool:
        """Whether frames are told what to expect; only where they refer to those before."""

    @abstractmethod
    def _coded(
        self,
        frame: Frame,
        valid: Mask,
        expected: Ranges | None,
        edge: KnownColumns | None,
        firing: int,
        sent: Ranges | None,
    ) -> bytes:
        """The RANGE section. valid: (64, W) bool, the returns that are sent; expected: (64, W) uint16, 0 = nothing.

        edge: the columns before a slab, None for a whole frame; firing: that of the first column, counted
        sent: (64, W) zeros, takes free ranges as a decoder gets them; None: ranges are rounded
        """

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

    def _mask_in_stream(self) -> EncodeMask | None:
        return self._encode_mask if self._expects() else None

    def _encode_mask(self, frame: Frame) -> bytes:
        motion = None if self._expected is None or self._motion is None else self._motion.numbers
        given = (frame.azimuth, frame.fired, beam_rows(frame.sensor), self._expected, motion)
        return self._masks.encode(frame.valid, *given)

    def _sections(self, frame: Frame, key: bool) -> tuple[list[Section], int | None]:
        fresh = key or self._history is None or not self._remembers()
        self._slab = bool(frame.valid.any()) and swept(frame.azimuth) < AZIMUTH_TURN // 2
        try:
            motion = self._expect(frame, fresh)
            sections, needs = super()._sections(frame, key)
            if self._remembers():
                self._remember(frame)
        except BaseException:
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
            self._masks.forget()
            self._motion = None
            return []
        if motion is None:
            return []
        self._expected = self._sent.expected(motion, frame.azimuth, frame.fired, frame.sensor)
        as_before = self._slab and motion == self._motion
        self._motion = motion
        return [Section(SectionType.MOTION, b"" if as_before else encode_motion(motion))]

    def _range(self, frame: Frame, valid: Mask) -> bytes:
        edge = self._sent.edge_before(frame.azimuth) if self._slab else None
        firing = self._firings.columns_before(frame) if self._remembers() else 0  # alone, a frame may begin anywhere
        self._free = np.zeros(valid.shape, np.uint16) if self.settings.is_free else None
        return self._coded(frame, valid, self._expected, edge, firing, self._free)

    def _remember(self, frame: Frame) -> None:
        if not self._slab:
            self._sent.forget_edge()
        if self._slab or self._finder is not None:
            rounded = (frame.range, frame.valid, self.settings.step, frame.sensor)
            sent = as_decoded(*rounded) if self._free is None else self._free
        if self._slab:
            self._sent.remember_edge(sent, frame.azimuth, frame.fired, self._expected)
        if self._finder is not None:
            self._sent.remember(sent, frame.azimuth, frame.fired, frame.sensor, slab=self._slab)


class ExpectingDecoder(IntraDecoder):
    """The decoder of such a codec. memory: what its coder of ranges learns."""

    def __init__(self, codec_id: int, memory: Memory) -> None:
        super().__init__(codec_id)
        self._sent: Final = StreamHistory(memory)
        self._motion: Motion | None = None
        self._masks: Final = MaskStream()
        self._foreseen: Ranges | None = None  # of the message at hand, once it is known

    @abstractmethod
    def _columns_before(self, data: bytes) -> int | None:
        """How many columns before it a RANGE section refers to; None for a whole frame, and without returns.

        Raises SectionError or TruncatedError.
        """

    @abstractmethod
    def _decoded(
        self, data: bytes, planes: Planes, sensor: SensorModel, expected: Ranges | None, edge: KnownColumns | None
    ) -> Ranges:
        """(64, W) uint16 of a RANGE section, not 0 where `planes.valid`, 0 elsewhere; expected, edge: as it was coded.

        Raises SectionError or TruncatedError.
        """

    def _begin(self, message: Message, sensor: SensorModel) -> DecodeMask | None:
        """Begins a message: what it says of the sensor's motion both its mask and its ranges need."""
        self._last = None  # a message that fails halfway has taught something else than its encoder learned
        self._foreseen = None
        if message.needs is None:
            self._sent.forget()
            self._masks.forget()
            self._motion = None

        def decode_mask(data: bytes, azimuth: Ranges, fired: Mask) -> Mask:
            expected = self._expected(message, azimuth, fired, sensor)
            motion = None if expected is None or self._motion is None else self._motion.numbers
            return self._masks.decode(data, azimuth, fired, beam_rows(sensor), expected, motion)

        return decode_mask

    def _ranges(self, message: Message, planes: Planes, sensor: SensorModel) -> Ranges:
        expected = self._expected(message, planes.azimuth, planes.fired, sensor)
        data = message.section(SectionType.RANGE)
        columns = self._columns_before(data)
        edge = None if columns is None else self._sent.edge_of(columns)
        ranges = self._decoded(data, planes, sensor, expected, edge)
        if edge is None:
            self._sent.forget_edge()
        else:
            self._sent.remember_edge(ranges, planes.azimuth, planes.fired, expected)
        self._sent.remember(ranges, planes.azimuth, planes.fired, sensor, slab=edge is not None)
        return ranges

    def _expected(self, message: Message, azimuth: Ranges, fired: Mask, sensor: SensorModel) -> Ranges | None:
        if not message.has(SectionType.MOTION):
            return None
        if self._foreseen is None:
            data = message.section(SectionType.MOTION)
            if data:
                self._motion = decode_motion(data)
            elif self._motion is None:
                raise SectionError("a motion as before, and there was none")
            self._foreseen = self._sent.expected(self._motion, azimuth, fired, sensor)
        return self._foreseen

"""Encoder part of codecs whose ranges refer to frames since the last key message: `predictive` and `riddle`.

`ReferenceTracker` says what a frame is coded with beside itself, a `Reference`: the ranges to expect, with the motion
of the sensor that they were moved by, the columns before a slab, and the count of firings. `Referring` gives it to the
mask and to the codec's own `RangeCoder`, and hands back to the tracker what was sent. So each frame is:

    reference -> mask and other planes -> ranges -> what the next reference may use

A message without a MOTION section expects nothing. A frame that begins from nothing never expects anything.

A frame of less than half a turn is a *slab*: it goes on where the slab before ended, with the columns there (*edge*) as
if they were its own, and with the motion of the message before where that is still the best one known.
"""

from __future__ import annotations

from typing import Final, Generic, NamedTuple, Protocol, TypeVar

import numpy as np
import numpy.typing as npt

from lidarcodec.codecs.base import CodecSettings, InForce
from lidarcodec.codecs.frame_encoder import Coded
from lidarcodec.entropy import KnownColumns, MaskStream, PredictiveCoder, ReturnSamples, columns_in_turn
from lidarcodec.frame import Frame
from lidarcodec.message import Section, SectionType
from lidarcodec.motion.finder import MotionFinder
from lidarcodec.motion.history import MaskHistory, StreamHistory
from lidarcodec.motion.motion import Motion, encode_motion
from lidarcodec.motion.warp import beam_rows, swept
from lidarcodec.planes.intensity import Quality
from lidarcodec.planes.sections import encode_planes
from lidarcodec.ranges.firings import FiringCounter
from lidarcodec.ranges.image.canvas import level_offsets
from lidarcodec.ranges.quantise import as_decoded
from lidarcodec.settings import StreamSettings
from lidarcodec.units import AZIMUTH_TURN

Ranges = npt.NDArray[np.uint16]


class ReferringSettings(CodecSettings):
    """Settings that such codecs share."""

    effort: int
    memory: bool = True
    """Whether a frame uses statistics of all frames since the last key frame. Frames get smaller, but need those
    frames to be decoded."""
    motion: bool = True
    """Whether frames are predicted from the previous turn, with the motion of the sensor. Needs `memory`."""

    @property
    def expects(self) -> bool:
        """Whether ranges to expect are computed."""
        return self.memory and self.motion


OwnReferring = TypeVar("OwnReferring", bound=ReferringSettings)


class Reference(NamedTuple):
    """What a frame of W columns is coded with beside itself. A decoder knows all of it but `firing`.

    expected: (64, W) uint16 range steps, 0 = nothing; None: nothing is expected
    motion: of the sensor since the last turn, by which `expected` was moved; None without `expected`
    moves_on: whether the motion is that of the message before, and need not be sent
    edge: the columns before a slab; None for a whole frame
    firing: columns that the sensor fired before this frame, as far as known
    """

    expected: Ranges | None = None
    motion: Motion | None = None
    moves_on: bool = False
    edge: KnownColumns | None = None
    firing: int = 0


class CodedRanges(NamedTuple):
    """data: the bytes; free: (64, W) uint16 ranges as a decoder gets them, None where they are rounded."""

    data: bytes
    free: Ranges | None


def coded_ranges(
    coder: PredictiveCoder,
    frame: Frame,
    reference: Reference,
    settings: StreamSettings,
    *,
    quick: bool,
    samples: ReturnSamples | None = None,
) -> CodedRanges:
    """The ranges of the frame's `valid` returns as `coder` writes them, without the step in front.

    quick: use the best contexts only; samples: takes what a network may be trained on
    """
    free = np.zeros(frame.range.shape, np.uint16) if settings.is_free else None
    coded = coder.encode(
        frame.range_u16,
        frame.valid,
        frame.fired,
        frame.sensor,
        settings.step,
        level_offsets(frame.sensor),
        turn=columns_in_turn(frame.azimuth) if frame.fired.all() else None,
        firing=reference.firing,
        expected=reference.expected,
        slab_after=reference.edge,
        samples=samples,
        quick=quick,
        sent=free,
    )
    return CodedRanges(coded, free)


class RangeCoder(Protocol[OwnReferring]):
    """How such a codec writes ranges. It may learn from frame to frame."""

    def take(self, settings: InForce[OwnReferring]) -> bool:
        """Follow these settings. True: the next message must be a key message. Raises SettingsError."""

    def reset(self) -> None:
        """Forget what was learned since the last message that needs no other."""

    def encode(self, frame: Frame, reference: Reference) -> CodedRanges:
        """The ranges of the frame's `valid` returns."""


class ReferenceTracker:
    """What a stream has sent since the last message that needs no other, as the reference of the next frame."""

    def __init__(self) -> None:
        self._sent: Final = StreamHistory()
        self._firings: Final = FiringCounter()
        self._finder: MotionFinder | None = None
        self._motion: Motion | None = None

    def expect(self, expects: bool) -> bool:
        """Say whether to expect ranges from the next frame on; whether the stream has to begin from nothing for it."""
        begins = expects and self._finder is None
        if begins:
            self._finder = MotionFinder()
        elif not expects:
            self._finder = None
        return begins

    def begin(self, frame: Frame) -> Reference:
        """Forget everything; the reference of a frame that begins from nothing."""
        if self._finder is not None:
            self._finder.next(frame, self._sent.seen)
        self._sent.forget()
        self._motion = None
        return Reference(edge=self._edge(frame))

    def go_on(self, frame: Frame) -> Reference:
        """The reference of a frame that goes on from those before."""
        edge = self._edge(frame)
        motion = None if self._finder is None else self._finder.next(frame, self._sent.seen).motion
        if motion is None:
            return Reference(edge=edge)
        expected = self._sent.expected(motion, frame.azimuth, frame.fired, frame.sensor)
        moves_on = edge is not None and motion == self._motion
        self._motion = motion
        return Reference(expected, motion, moves_on, edge)

    def counted(self, frame: Frame, reference: Reference) -> Reference:
        """The reference with the count of firings."""
        return reference._replace(firing=self._firings.columns_before(frame))

    def take(self, frame: Frame, reference: Reference, free: Ranges | None, step: int) -> None:
        """Take a frame that was sent. free: of `CodedRanges`; step: of rounded ranges."""
        if reference.edge is None:
            self._sent.forget_edge()
            if self._finder is None:
                return
        sent = as_decoded(frame.range_u16, frame.valid, step, level_offsets(frame.sensor)) if free is None else free
        if reference.edge is not None:
            self._sent.remember_edge(sent, frame.azimuth, frame.fired, reference.expected)
        if self._finder is not None:
            slab = reference.edge is not None
            self._sent.remember(sent, frame.azimuth, frame.fired, frame.sensor, slab=slab)

    def _edge(self, frame: Frame) -> KnownColumns | None:
        slab = bool(frame.valid.any()) and swept(frame.azimuth) < AZIMUTH_TURN // 2
        return self._sent.edge_before(frame.azimuth) if slab else None


class Referring(Generic[OwnReferring]):
    """Content of such a codec. ranges: writes the RANGE section."""

    _settings: InForce[OwnReferring]

    def __init__(self, ranges: RangeCoder[OwnReferring]) -> None:
        self._ranges: Final = ranges
        self._references: Final = ReferenceTracker()
        self._mask_stream: Final = MaskStream()
        self._masks: MaskHistory | None = None
        self._last: int | None = None
        """Index of the frame that the next one may go on from; None: it begins from nothing."""

    def take(self, settings: InForce[OwnReferring]) -> bool:
        """Takes settings. A frame that is to expect something for the first time begins from nothing."""
        key = self._ranges.take(settings)
        self._settings = settings
        if self._references.expect(settings.own.expects):
            self._last = None
        return key

    def code(self, frame: Frame, *, key: bool) -> Coded:
        """Ranges, planes and motion of a frame."""
        settings, remembers = self._settings, self._settings.own.memory
        needs = self._last if remembers and not key else None
        self._last = None  # until the frame is whole: no decoder learns what a frame that fails has taught
        reference = self._reference(frame, begins=needs is None)
        planes = self._planes(frame, reference)
        if remembers:  # coded alone, a frame may begin anywhere
            reference = self._references.counted(frame, reference)
        data, free = self._ranges.encode(frame, reference)
        sections = [Section(SectionType.RANGE, data), *planes]
        if reference.motion is not None:
            moved = b"" if reference.moves_on else encode_motion(reference.motion)
            sections.append(Section(SectionType.MOTION, moved))
        if remembers:
            self._masks = self._masks or MaskHistory()
            self._masks.remember(frame.valid, frame.azimuth, frame.sensor)
            self._references.take(frame, reference, free, settings.stream.step)
            self._last = frame.index
        return Coded(sections, needs)

    def _reference(self, frame: Frame, *, begins: bool) -> Reference:
        if not begins:
            return self._references.go_on(frame)
        self._masks = None
        self._mask_stream.forget()
        self._ranges.reset()
        return self._references.begin(frame)

    def _planes(self, frame: Frame, reference: Reference) -> list[Section]:
        quality = Quality.of(self._settings.stream)
        if frame.keep is None and self._settings.own.expects:
            return encode_planes(frame, quality, encode_mask=lambda of: self._mask(of, reference))
        previous = None if self._masks is None else self._masks.before(frame.azimuth, frame.sensor)
        return encode_planes(frame, quality, previous)

    def _mask(self, frame: Frame, reference: Reference) -> bytes:
        numbers = None if reference.motion is None else reference.motion.numbers
        given = (frame.azimuth, frame.fired, beam_rows(frame.sensor), reference.expected, numbers)
        return self._mask_stream.encode(frame.valid, *given)

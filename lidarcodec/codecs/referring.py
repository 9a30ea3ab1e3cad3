"""Encoder part of codecs whose ranges refer to frames since the last key message: `predictive` and `riddle`.

A frame goes on from the `Memory` after another one: what was sent up to that, and what the coders learned.
`ReferenceTracker` says by it what the frame is coded with beside itself, a `Reference`: the ranges to expect, with the
motion of the sensor that they were moved by, the columns before a slab, and the count of firings. `Referring` gives it
to the mask and to the codec's own `RangeCoder`. So each frame is:

    memory after an earlier frame -> reference -> mask and other planes -> ranges -> memory after this frame

A message without a MOTION section expects nothing. A frame that begins from nothing never expects anything.

A frame of less than half a turn is a *slab*: it goes on where the slab before ended, with the columns there (*edge*) as
if they were its own, and with the motion of the message before where that is still the best one known.
"""

from __future__ import annotations

from collections.abc import Callable, Set
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Final, Generic, NamedTuple, Protocol, TypeVar

import numpy as np
import numpy.typing as npt

from lidarcodec.codecs.base import CodecSettings, InForce
from lidarcodec.codecs.frame_encoder import Coded
from lidarcodec.codecs.kept_frames import KeptFrames, TurnParts
from lidarcodec.entropy import (
    IntensityMemory,
    KnownColumns,
    MaskStream,
    PredictiveCoder,
    ReturnSamples,
    columns_in_turn,
)
from lidarcodec.frame import Frame
from lidarcodec.message import Section, SectionType
from lidarcodec.motion.finder import MotionFinder
from lidarcodec.motion.history import MaskHistory, StreamHistory
from lidarcodec.motion.motion import Motion, encode_motion
from lidarcodec.motion.warp import beam_rows, swept
from lidarcodec.planes.intensity import Quality
from lidarcodec.planes.sections import planes_beside
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
    goes_on: whether the frame goes on from another
    """

    expected: Ranges | None = None
    motion: Motion | None = None
    moves_on: bool = False
    edge: KnownColumns | None = None
    firing: int = 0
    goes_on: bool = False


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
        halves=reference.goes_on,
    )
    return CodedRanges(coded, free)


Learned = TypeVar("Learned")
"""What a coder of ranges learned up to a frame."""


class RangeCoder(Protocol[OwnReferring, Learned]):
    """How such a codec writes ranges. What it learns from frame to frame is held by its caller."""

    def take(self, settings: InForce[OwnReferring]) -> bool:
        """Follow these settings. True: the next message must be a key message. Raises SettingsError."""

    def begin(self) -> Learned:
        """Nothing learned."""

    def copy(self, learned: Learned) -> Learned:
        """The same once more."""

    def encode(self, frame: Frame, reference: Reference, learned: Learned) -> CodedRanges:
        """The ranges of the frame's `valid` returns. Changes `learned`."""


@dataclass
class SentFrames:
    """What a stream has sent up to a frame, since the last message that needs no other.

    motion: of the last frame with one
    """

    ranges: StreamHistory
    motion: Motion | None = None

    def copy(self) -> SentFrames:
        """The same once more."""
        return SentFrames(self.ranges.copy(), self.motion)


class ReferenceTracker:
    """Makes the references of the frames of a stream from what was sent."""

    def __init__(self) -> None:
        self._firings: Final = FiringCounter()
        self._finder: MotionFinder | None = None
        self._last = StreamHistory()
        """What was sent up to the last frame."""

    def expect(self, expects: bool) -> bool:
        """Say whether to expect ranges from the next frame on; whether the stream has to begin from nothing for it."""
        begins = expects and self._finder is None
        if begins:
            self._finder = MotionFinder()
        elif not expects:
            self._finder = None
        return begins

    def begin(self, frame: Frame) -> Reference:
        """The reference of a frame that begins from nothing."""
        if self._finder is not None:
            self._finder.next(frame, self._last.seen)
        return Reference(edge=_edge(frame, StreamHistory()))

    def go_on(self, frame: Frame, sent: SentFrames) -> Reference:
        """The reference of a frame that goes on from others."""
        edge = _edge(frame, sent.ranges)
        motion = None if self._finder is None else self._finder.next(frame, sent.ranges.seen).motion
        if motion is None:
            return Reference(edge=edge, goes_on=True)
        expected = sent.ranges.expected(motion, frame.azimuth, frame.fired, frame.sensor)
        moves_on = edge is not None and motion == sent.motion
        sent.motion = motion
        return Reference(expected, motion, moves_on, edge, goes_on=True)

    def counted(self, frame: Frame, reference: Reference) -> Reference:
        """The reference with the count of firings."""
        return reference._replace(firing=self._firings.columns_before(frame))

    def take(self, frame: Frame, reference: Reference, coded: CodedRanges, step: int, sent: SentFrames) -> None:
        """Add a frame to what was sent. step: of rounded ranges."""
        self._last = sent.ranges
        if reference.edge is None:
            sent.ranges.forget_edge()
            if self._finder is None:
                return
        ranges = _decoded(frame, coded, step)
        if reference.edge is not None:
            sent.ranges.remember_edge(ranges, frame.azimuth, frame.fired, reference.expected)
        if self._finder is not None:
            slab = reference.edge is not None
            sent.ranges.remember(ranges, frame.azimuth, frame.fired, frame.sensor, slab=slab)


def _decoded(frame: Frame, coded: CodedRanges, step: int) -> Ranges:
    """(64, W) uint16, the ranges as a decoder gets them."""
    if coded.free is not None:
        return coded.free
    return as_decoded(frame.range_u16, frame.valid, step, level_offsets(frame.sensor))


def _edge(frame: Frame, sent: StreamHistory) -> KnownColumns | None:
    slab = bool(frame.valid.any()) and swept(frame.azimuth) < AZIMUTH_TURN // 2
    return sent.edge_before(frame.azimuth) if slab else None


@dataclass
class Memory(Generic[Learned]):
    """What encoder and decoder both know after a frame."""

    sent: SentFrames
    mask_stream: MaskStream
    masks: MaskHistory
    intensities: IntensityMemory
    learned: Learned

    @classmethod
    def begin(cls, learned: Learned) -> Memory[Learned]:
        """Of no frame."""
        intensities = IntensityMemory(follows=True)
        return cls(SentFrames(StreamHistory()), MaskStream(), MaskHistory(), intensities, learned)


class Referring(Generic[OwnReferring, Learned]):
    """Content of such a codec. ranges: writes the RANGE section."""

    _settings: InForce[OwnReferring]

    def __init__(self, ranges: RangeCoder[OwnReferring, Learned]) -> None:
        self._ranges: Final = ranges
        self._references: Final = ReferenceTracker()
        self._kept: Final = KeptFrames[Memory[Learned]](self._copy)
        self._turn: Final = TurnParts()

    def take(self, settings: InForce[OwnReferring]) -> bool:
        """Takes settings. A frame that is to expect something for the first time begins from nothing."""
        key = self._ranges.take(settings)
        self._settings = settings
        if self._references.expect(settings.own.expects):
            self._kept.forget()
        return key

    def refer_to(self, indices: Set[int] | None) -> None:
        """Refer to the newest of these frames; None: to the frame before."""
        self._kept.refer_to(indices)

    def code(self, frame: Frame, *, key: bool) -> Coded:
        """Ranges, planes and motion of a frame."""
        settings, remembers = self._settings, self._settings.own.memory
        goes_on = remembers and self._turn.goes_on(frame, key=key)
        memory_before = self._kept.go_on(frame.index - 1) if goes_on else None
        found = self._kept.reference() if remembers and not key and not goes_on else None
        if memory_before is not None:
            found = frame.index - 1, memory_before
        if found is None:
            self._kept.forget()
            needs, memory = None, Memory.begin(self._ranges.begin())
            reference = self._references.begin(frame)
        else:
            needs, memory = found
            reference = self._references.go_on(frame, memory.sent)
        with self._planes(frame, reference, memory, follows=needs is not None) as planes:
            if remembers:  # coded alone, a frame may begin anywhere
                reference = self._references.counted(frame, reference)
            coded = self._ranges.encode(frame, reference, memory.learned)
            sections = [Section(SectionType.RANGE, coded.data), *planes()]
        if reference.motion is not None:
            moved = b"" if reference.moves_on else encode_motion(reference.motion)
            sections.append(Section(SectionType.MOTION, moved))
        step = settings.stream.step
        if remembers:
            memory.masks.remember(frame.valid, frame.azimuth, frame.sensor)
            self._references.take(frame, reference, coded, step, memory.sent)
            self._kept.put(frame.index, memory)
            self._turn.coded(frame)
        return Coded(sections, needs, lambda: _decoded(frame, coded, step), goes_on)

    def _copy(self, memory: Memory[Learned]) -> Memory[Learned]:
        learned = self._ranges.copy(memory.learned)
        intensities = memory.intensities.copy()
        return Memory(memory.sent.copy(), memory.mask_stream.copy(), memory.masks.copy(), intensities, learned)

    def _planes(
        self, frame: Frame, reference: Reference, memory: Memory[Learned], *, follows: bool
    ) -> AbstractContextManager[Callable[[], list[Section]]]:
        quality = Quality.of(self._settings.stream)
        intensities = memory.intensities if self._settings.own.memory else None
        if frame.keep is None and self._settings.own.expects:
            encode_mask = lambda of: _mask(of, reference, memory.mask_stream)  # noqa: E731
            return planes_beside(frame, quality, encode_mask=encode_mask, memory=intensities)
        previous = memory.masks.before(frame.azimuth, frame.sensor) if follows else None
        return planes_beside(frame, quality, previous, memory=intensities)


def _mask(frame: Frame, reference: Reference, stream: MaskStream) -> bytes:
    numbers = None if reference.motion is None else reference.motion.numbers
    given = (frame.azimuth, frame.fired, beam_rows(frame.sensor), reference.expected, numbers)
    return stream.encode(frame.valid, *given)

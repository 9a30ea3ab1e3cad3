"""`predictive`: what is likely is learned while coding, from the returns around each return. No weights, any sensor.

Fewer bits than `pcodec`, in two to three times its time (docs/codecs.md). `effort=2` uses more contexts. With `memory`,
the default, the statistics of a frame continue those of an earlier frame, and masks refer to masks of the last turn.
Offline that is the frame before; live it is one that the followed receiver has.

With `motion` the ranges of a turn ago, moved as the sensor moved since, are a context for ranges and masks
(`entropy.MaskStream`). Slabs (frames of less than half a turn) continue where the slab before ended.

A RANGE section is the step u16, then the bytes of docs/wire-format-predictive.md.
"""

from __future__ import annotations

from pydantic import Field

from lidarcodec import entropy
from lidarcodec.codecs.base import Codec, Encoder, InForce
from lidarcodec.codecs.frame_decoder import SessionDecoder
from lidarcodec.codecs.frame_encoder import FrameEncoder
from lidarcodec.codecs.rate_knob import bound_knob
from lidarcodec.codecs.referring import CodedRanges, Reference, Referring, ReferringSettings, coded_ranges
from lidarcodec.frame import Frame
from lidarcodec.ranges.steps import with_step
from lidarcodec.settings import StreamSettings


class PredictiveSettings(ReferringSettings):
    """Settings of `predictive`."""

    effort: int = Field(1, ge=1, le=2)
    """1: the best contexts only. 2: all contexts. 2 saves up to 0.05 bit a return and takes an eighth to a third more
    time."""
    motion: bool = False
    """Whether frames are predicted from the previous turn, with the motion of the sensor. Needs `memory`."""


class PredictiveRanges:
    """Writes ranges by what is learned while coding."""

    _settings: InForce[PredictiveSettings]

    def take(self, settings: InForce[PredictiveSettings]) -> bool:
        """Takes settings; no frame needs a key message for them."""
        self._settings = settings
        return False

    def begin(self) -> entropy.PredictiveCoder:
        """A coder that learned nothing."""
        return entropy.PredictiveCoder()

    def copy(self, learned: entropy.PredictiveCoder) -> entropy.PredictiveCoder:
        """The coder once more."""
        return learned.copy()

    def encode(self, frame: Frame, reference: Reference, learned: entropy.PredictiveCoder) -> CodedRanges:
        """The RANGE section of a frame."""
        stream = self._settings.stream
        coded, free = coded_ranges(learned, frame, reference, stream, quick=self._settings.own.effort == 1)
        return CodedRanges(with_step(stream.step, coded), free)


def _encoder(codec_id: int, settings: StreamSettings, stream_id: int) -> Encoder:
    return FrameEncoder(codec_id, settings, stream_id, PredictiveSettings, Referring(PredictiveRanges()))


CODEC = Codec(PredictiveSettings, _encoder, SessionDecoder, knob=bound_knob(), layered=True, parts=True)

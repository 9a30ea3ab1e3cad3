"""`predictive`: what is likely is learned while coding, from the returns around each return. No weights, any sensor.

Half a bit to two thirds of a bit a return less than `pcodec`, and two to three times the time: 6.2 bits lossless, 2.9
within a centimetre, 1.6 within five on KITTI, 14 ms each way on a Zen 3. `effort=2` takes a third longer over ranges
lossless, for as many bits in a long stream, and an eighth to a fifth longer within five centimetres, for 1 to 2 % less.
With `memory`, on by default, a frame goes on from what the one before taught, which saves 0.06 bit, and masks refer to
those of the last turn; a lost message then costs all frames up to the next key frame.

With `motion` it also expects what the sensor saw a turn ago, moved as the sensor moved since: 0.1 to 0.2 bit less, for
15 ms more to encode (5 of them to find the motion where frames have no poses) and 10 to decode. Masks then are
coded by a coder that looks at all of that (`entropy.MaskStream`).

Slabs (frames of less than half a turn) go on where the one before ended, and cost hardly more than whole frames.

A RANGE section is the step u16, then the bytes of docs/wire-format-predictive.md. A message that needs no other begins
from nothing; one that does goes on from where that left off.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from pydantic import Field

from lidarcodec import entropy
from lidarcodec.codecs.base import Codec, Encoder, InForce
from lidarcodec.codecs.frame_encoder import FrameEncoder
from lidarcodec.codecs.rate_knob import bound_knob
from lidarcodec.codecs.referring import CodedRanges, Reference, Referring, ReferringSettings
from lidarcodec.codecs.referring_decoder import ReferringDecoder
from lidarcodec.entropy import KnownColumns
from lidarcodec.frame import Frame
from lidarcodec.message import Message
from lidarcodec.planes.sections import Planes
from lidarcodec.ranges.image.canvas import level_offsets
from lidarcodec.ranges.steps import split_step, with_step
from lidarcodec.sensor_model import SensorModel
from lidarcodec.settings import StreamSettings

Ranges = npt.NDArray[np.uint16]


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

    def __init__(self) -> None:
        self._coder = entropy.PredictiveCoder()

    def take(self, settings: InForce[PredictiveSettings]) -> bool:
        """Takes settings; no frame needs a key message for them."""
        self._settings = settings
        return False

    def reset(self) -> None:
        """Forgets what was learned."""
        self._coder.reset()

    def encode(self, frame: Frame, reference: Reference) -> CodedRanges:
        """The RANGE section of a frame."""
        stream = self._settings.stream
        free = np.zeros(frame.range.shape, np.uint16) if stream.is_free else None
        coded = self._coder.encode(
            frame.range,
            frame.valid,
            frame.fired,
            frame.sensor,
            stream.step,
            level_offsets(frame.sensor),
            turn=entropy.columns_in_turn(frame.azimuth) if frame.fired.all() else None,
            firing=reference.firing,
            expected=reference.expected,
            slab_after=reference.edge,
            quick=self._settings.own.effort == 1,
            sent=free,
        )
        return CodedRanges(with_step(stream.step, coded), free)


class PredictiveRangeDecoder:
    """Reads ranges by what is learned while decoding."""

    def __init__(self) -> None:
        self._coder = entropy.PredictiveCoder()

    def reset(self) -> None:
        """Forgets what was learned."""
        self._coder.reset()

    def begin(self, message: Message, planes: Planes) -> None:
        """Nothing: ranges need nothing else of a message."""

    def columns_before(self, data: bytes) -> int | None:
        """How many columns before it a RANGE section refers to. Raises SectionError or TruncatedError."""
        return entropy.known_columns(split_step(data)[1])

    def decode(
        self, data: bytes, planes: Planes, sensor: SensorModel, expected: Ranges | None, edge: KnownColumns | None
    ) -> Ranges:
        """(64, W) uint16 of a RANGE section. Raises SectionError or TruncatedError."""
        step, coded = split_step(data)
        given = (planes.valid, planes.fired, sensor, step, level_offsets(sensor))
        return self._coder.decode(coded, *given, expected=expected, slab_after=edge)


def _encoder(codec_id: int, settings: StreamSettings, stream_id: int) -> Encoder:
    return FrameEncoder(codec_id, settings, stream_id, PredictiveSettings, Referring(PredictiveRanges()))


def _decoder(codec_id: int) -> ReferringDecoder:
    return ReferringDecoder(codec_id, PredictiveRangeDecoder())


CODEC = Codec(PredictiveSettings, _encoder, _decoder, knob=bound_knob())

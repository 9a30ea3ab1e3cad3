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
from lidarcodec.codecs.base import Codec, CodecSettings, own_settings
from lidarcodec.codecs.expecting import ExpectingDecoder, ExpectingEncoder
from lidarcodec.codecs.rate_knob import bound_knob
from lidarcodec.entropy import KnownColumns
from lidarcodec.frame import Frame
from lidarcodec.planes.sections import Planes
from lidarcodec.ranges.image.canvas import level_offsets
from lidarcodec.ranges.steps import split_step, with_step
from lidarcodec.sensor_model import SensorModel
from lidarcodec.settings import StreamSettings

Ranges = npt.NDArray[np.uint16]
Mask = npt.NDArray[np.bool_]


class PredictiveSettings(CodecSettings):
    """Settings of `predictive`."""

    effort: int = Field(1, ge=1, le=2)
    """1: the best contexts only. 2: all contexts. 2 saves up to 0.05 bit a return and takes an eighth to a third more
    time."""

    memory: bool = True
    """Whether a frame uses statistics of all frames since the last key frame. Frames get smaller, but need those
    frames to be decoded."""
    motion: bool = False
    """Whether frames are predicted from the previous turn, with the motion of the sensor. Needs `memory`."""

    @property
    def expects(self) -> bool:
        """Whether frames are told what to expect."""
        return self.memory and self.motion


class PredictiveEncoder(ExpectingEncoder):
    """Encoder of `predictive`."""

    def __init__(self, codec_id: int, settings: StreamSettings, stream_id: int) -> None:
        self._coder = entropy.PredictiveCoder()
        super().__init__(codec_id, settings, stream_id, self._coder)

    def _remembers(self) -> bool:
        return own_settings(PredictiveSettings, self.settings).memory

    def _expects(self) -> bool:
        return own_settings(PredictiveSettings, self.settings).expects

    def _coded(
        self,
        frame: Frame,
        valid: Mask,
        expected: Ranges | None,
        edge: KnownColumns | None,
        firing: int,
        sent: Ranges | None,
    ) -> bytes:
        step = self.settings.step
        turn = entropy.columns_in_turn(frame.azimuth) if frame.fired.all() else None
        given = (frame.range, valid, frame.fired, frame.sensor, step, level_offsets(frame.sensor))
        quick = own_settings(PredictiveSettings, self.settings).effort == 1
        coded = self._coder.encode(
            *given, turn=turn, firing=firing, expected=expected, slab_after=edge, quick=quick, sent=sent
        )
        return with_step(step, coded)


class PredictiveDecoder(ExpectingDecoder):
    """Decoder of `predictive`."""

    def __init__(self, codec_id: int) -> None:
        self._coder = entropy.PredictiveCoder()
        super().__init__(codec_id, self._coder)

    def _columns_before(self, data: bytes) -> int | None:
        return entropy.known_columns(split_step(data)[1])

    def _decoded(
        self, data: bytes, planes: Planes, sensor: SensorModel, expected: Ranges | None, edge: KnownColumns | None
    ) -> Ranges:
        step, coded = split_step(data)
        given = (planes.valid, planes.fired, sensor, step, level_offsets(sensor))
        return self._coder.decode(coded, *given, expected=expected, slab_after=edge)


KNOB = bound_knob()

CODEC = Codec(PredictiveSettings, PredictiveEncoder, PredictiveDecoder, knob=KNOB)

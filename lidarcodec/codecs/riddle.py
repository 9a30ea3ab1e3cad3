"""`riddle`: what is likely is said by a small network, and corrected by what is learned while coding.

The coder of `predictive`, given a head start: a network in whole numbers looks at each return's surroundings and gives
log odds, to which those of the contexts are added. Trained before, on other drives; what it does not know of a place
or a sensor, the contexts learn. With `memory` and `motion`, both on by default, as `predictive` has them.

`effort` 1 goes without a network, 2 (the default) takes a small one, 3 a large one, 4 the largest: fewer bits for more
time each way.
`weights` names a file of one's own (docs/codecs.md says how to train it); it then travels with the key messages.

A RANGE section is the step u16, the effort u8, the name of the weights (8 bytes, zeros for none), then the bytes of
docs/wire-format-riddle.md. A WEIGHTS section holds a weight file.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt
from pydantic import Field

from lidarcodec import entropy
from lidarcodec.codecs.base import Codec, CodecSettings, own_settings
from lidarcodec.codecs.canvas import level_offsets
from lidarcodec.codecs.expecting import ExpectingDecoder, ExpectingEncoder
from lidarcodec.codecs.planes import Planes
from lidarcodec.codecs.range_steps import split_step, with_step
from lidarcodec.codecs.rate_knob import bound_knob
from lidarcodec.codecs.riddle_shelf import EFFORTS, Shelf, native_nets, networks_of, shipped, weights_of
from lidarcodec.codecs.riddle_weights import Weights, unpack_weights
from lidarcodec.entropy import KnownColumns
from lidarcodec.errors import LidarCodecError, SectionError, SettingsError, TruncatedError, UnknownNameError
from lidarcodec.frame import Frame
from lidarcodec.message import Message, Section, SectionType
from lidarcodec.sensor_model import SensorModel
from lidarcodec.settings import StreamSettings

Ranges = npt.NDArray[np.uint16]
Mask = npt.NDArray[np.bool_]

_NAME_BYTES: Final = 8


class RiddleSettings(CodecSettings):
    """Settings of `riddle`."""

    effort: int = Field(2, ge=EFFORTS[0], le=EFFORTS[-1])
    """1: no network, 2: a small one, 3: a large one, 4: the largest."""
    memory: bool = True
    """Whether a frame goes on from what those since the last key frame taught: smaller, but then it needs them."""
    motion: bool = True
    """Whether it also expects what was seen a turn ago, moved as the sensor moved; only with `memory`."""
    weights: str = ""
    """A weight file on the encoder's machine; by default the one in the package."""

    @property
    def expects(self) -> bool:
        """Whether frames are told what to expect."""
        return self.memory and self.motion


class LearnedCoder:
    """The coder of ranges with networks that can be changed; doing so forgets what it learned."""

    def __init__(self) -> None:
        self._coder = entropy.PredictiveCoder()
        self._used: tuple[str, int] | None = None

    def use(self, weights: Weights | None, effort: int) -> bool:
        """Code with these from now on; None: without a network. Whether they are others than before.

        Raises UnknownNameError if the weights have no network for a kind of frame.
        """
        wanted = ("", effort) if weights is None else (weights.name, effort)
        if self._used == wanted:
            return False
        nets = None if weights is None else native_nets(networks_of(weights, effort))
        self._coder = entropy.PredictiveCoder(nets=nets)
        self._used = wanted
        return True

    def reset(self) -> None:
        """Forget what was learned."""
        self._coder.reset()

    @property
    def coder(self) -> entropy.PredictiveCoder:
        """The coder itself."""
        return self._coder


class RiddleEncoder(ExpectingEncoder):
    """Encoder of `riddle`. Raises SettingsError for weights that cannot be used."""

    def __init__(self, codec_id: int, settings: StreamSettings, stream_id: int) -> None:
        self._memory = LearnedCoder()
        super().__init__(codec_id, settings, stream_id, self._memory)
        self._own = own_settings(RiddleSettings, settings)
        self._weights = _weights_for(self._own)
        self._memory.use(self._weights, self._own.effort)

    def apply(self, settings: StreamSettings) -> bool:
        """Takes new settings; other weights, or another effort, begin with a key message."""
        own = own_settings(RiddleSettings, settings)
        if (own.weights, own.effort) != (self._own.weights, self._own.effort):
            weights = _weights_for(own)
            if self._memory.use(weights, own.effort):
                self._since_key = None
            self._weights = weights
        self._own = own
        return super().apply(settings)

    def _remembers(self) -> bool:
        return self._own.memory

    def _expects(self) -> bool:
        return self._own.expects

    def _sections(self, frame: Frame, key: bool) -> tuple[list[Section], int | None]:
        sections, needs = super()._sections(frame, key)
        if key and self._weights is not None and self._weights.name not in shipped():
            sections.append(Section(SectionType.WEIGHTS, self._weights.data))
        return sections, needs

    def _coded(self, frame: Frame, valid: Mask, expected: Ranges | None, edge: KnownColumns | None) -> bytes:
        step = self.settings.step
        turn = entropy.columns_in_turn(frame.azimuth) if frame.fired.all() else None
        given = (frame.range, valid, frame.fired, frame.sensor, step, level_offsets(frame.sensor))
        coded = self._memory.coder.encode(*given, turn=turn, expected=expected, slab_after=edge)
        name = bytes(_NAME_BYTES) if self._weights is None else bytes.fromhex(self._weights.name)
        return with_step(step, bytes([self._own.effort]) + name + coded)


def _weights_for(own: RiddleSettings) -> Weights | None:
    """Weights with networks for all frames, None where settings ask for none. Raises SettingsError."""
    if own.effort == EFFORTS[0]:
        return None
    try:
        weights = weights_of(own.weights)
        networks_of(weights, own.effort)
    except LidarCodecError as error:
        raise SettingsError(str(error), "codec_settings.weights") from None
    return weights


class RiddleDecoder(ExpectingDecoder):
    """Decoder of `riddle`."""

    def __init__(self, codec_id: int) -> None:
        self._memory = LearnedCoder()
        super().__init__(codec_id, self._memory)
        self._shelf = Shelf()
        self._begins, self._frame = False, 0

    def _ranges(self, message: Message, planes: Planes, sensor: SensorModel) -> Ranges:
        if message.has(SectionType.WEIGHTS):
            self._shelf.put(unpack_weights(message.section(SectionType.WEIGHTS)))
        self._begins, self._frame = message.needs is None, message.frame_index
        return super()._ranges(message, planes, sensor)

    def _columns_before(self, data: bytes) -> int | None:
        return entropy.known_columns(_split(data)[3])

    def _decoded(
        self, data: bytes, planes: Planes, sensor: SensorModel, expected: Ranges | None, edge: KnownColumns | None
    ) -> Ranges:
        step, effort, name, coded = _split(data)
        weights = None if effort == EFFORTS[0] else self._shelf.find(name, self._frame)
        try:
            changed = self._memory.use(weights, effort)
        except UnknownNameError as error:
            raise SectionError(str(error)) from None
        if changed and not self._begins:
            raise SectionError("other weights than those of the frame before, which it goes on from")
        given = (planes.valid, planes.fired, sensor, step, level_offsets(sensor))
        return self._memory.coder.decode(coded, *given, expected=expected, slab_after=edge)


def _split(data: bytes) -> tuple[int, int, str, bytes]:
    """Step, effort, name of the weights, and the rest. Raises SectionError or TruncatedError."""
    step, rest = split_step(data)
    if len(rest) < 1 + _NAME_BYTES:
        raise TruncatedError("ranges end within their header", len(data))
    if rest[0] not in EFFORTS:
        raise SectionError(f"ranges of effort {rest[0]}: {EFFORTS[0]} to {EFFORTS[-1]} are known")
    return step, rest[0], rest[1 : 1 + _NAME_BYTES].hex(), rest[1 + _NAME_BYTES :]


KNOB = bound_knob(
    (
        (20, 0.052),
        (10, 0.090),
        (5, 0.149),
        (2.5, 0.208),
        (1, 0.356),
        (0.5, 0.477),
        (0.25, 0.650),
        (0.1, 1.035),
        (0.05, 1.461),
        (0.02, 2.221),
        (0.01, 2.937),
        (0.004, 3.972),
        (0.002, 4.700),
        (0, 6.311),
    )
)
"""Bits of a return's range, mean of two drives (benchmarks/rate_traces.py)."""

CODEC = Codec(RiddleSettings, RiddleEncoder, RiddleDecoder, knob=KNOB)

"""`riddle`: a small network predicts what is likely, and contexts that learn while coding correct it.

The coder of `predictive`, given a head start: a network in whole numbers looks at each return's surroundings and gives
log odds, to which those of the contexts are added. Trained before, on other drives; what it does not know of a place
or a sensor, the contexts learn. With `memory` and `motion`, both on by default, as `predictive` has them.

`effort` 1 goes without a network, 2 (the default) takes a small one, 3 a large one, 4 the largest: fewer bits for more
time each way.
`weights` names a file of one's own (docs/codecs.md says how to train it); it then travels with the key messages.

With `learn_ms` a live publisher goes on training the network on what it sends, on a spare core; what it became travels
as an update in a message, and with the key messages. The encoder itself trains only when it is told to (`learn`).

A RANGE section is the step u16, the effort u8, the name of the weights (8 bytes, zeros for none), then the bytes of
docs/wire-format-riddle.md. A WEIGHTS section holds a weight file, or an update.

A return that is as expected takes next to no bits, but as much time as any other. So the sections of a message have a
byte for each RETURNS_PER_BYTE returns at least, if need be in a FILLER section of zeros. A message with fewer is
refused before its ranges are read.
"""

from __future__ import annotations

from collections.abc import Sequence, Set
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from pydantic import Field

from lidarcodec import entropy
from lidarcodec.codecs.base import Codec, InForce, own_settings
from lidarcodec.codecs.frame_decoder import SessionDecoder
from lidarcodec.codecs.frame_encoder import Coded, FrameEncoder
from lidarcodec.codecs.rate_knob import bound_knob
from lidarcodec.codecs.referring import CodedRanges, Reference, Referring, ReferringSettings, coded_ranges
from lidarcodec.entropy import NativeNets
from lidarcodec.errors import LidarCodecError, SettingsError
from lidarcodec.frame import Frame
from lidarcodec.message import Message, Section, SectionType
from lidarcodec.network.learner import Learner
from lidarcodec.network.networks import Weights
from lidarcodec.network.shelf import EFFORTS, native_nets, networks_of, shipped, weights_of
from lidarcodec.network.update import Update, weights_with
from lidarcodec.ranges.steps import with_step
from lidarcodec.settings import StreamSettings

Ranges = npt.NDArray[np.uint16]
Mask = npt.NDArray[np.bool_]

_NAME_BYTES: Final = 8
RETURNS_PER_BYTE: Final = 128
"""Most returns for a byte of a message's sections. Real frames have fewer, even within 20 m."""
MOST_LEARN_MS: Final = 1000


class RiddleSettings(ReferringSettings):
    """Settings of `riddle`."""

    effort: int = Field(2, ge=EFFORTS[0], le=EFFORTS[-1])
    """1: no network. 2: a small network. 3: a large network. 4: the largest network."""
    weights: str = ""
    """Name of a weight file in the package or in the folder of `--weights-dir`. On the command line of the encoder
    also a path."""
    learn_ms: float = Field(0, ge=0, le=MOST_LEARN_MS)
    """Milliseconds a frame for training. A live publisher then trains the network on its stream, on a spare core. 0:
    no training."""


@dataclass
class RiddleMemory:
    """What is known after a frame: the coder of ranges, the weights and effort that it has, and the last update of
    weights that was sent."""

    coder: entropy.PredictiveCoder | None = None
    used: tuple[str, int] | None = None
    told: Update | None = None

    def copy(self) -> RiddleMemory:
        """The same once more."""
        return RiddleMemory(None if self.coder is None else self.coder.copy(), self.used, self.told)


class NetworkRanges:
    """Writes ranges with networks, which can learn from what is coded. Raises SettingsError for weights that cannot be
    used."""

    _settings: InForce[RiddleSettings]

    def __init__(self, own: RiddleSettings) -> None:
        self._own = own
        self._weights = _weights_for(own)
        self._nets = _nets_of(self._weights, own.effort)
        self._learner: Learner | None = None
        self._update: Update | None = None
        self._told: Update | None = None
        self._tells = False

    def take(self, settings: InForce[RiddleSettings]) -> bool:
        """Takes new settings; other weights, or another effort, need a key message. What was learned in the stream is
        kept as long as the same network is in use."""
        own, before = settings.own, self._own
        weights, begins = self._weights, False
        if (own.weights, own.effort) != (before.weights, before.effort):
            weights = _weights_for(own)
            begins = (_name_of(weights), own.effort) != (_name_of(self._current), before.effort)
        if begins or own.expects != before.expects:
            self._nets = _nets_of(weights, own.effort)
            self._learner, self._update, self._told = None, None, None
        self._weights, self._own, self._settings = weights, own, settings
        return begins

    def begin(self) -> RiddleMemory:
        """Nothing learned; networks stay."""
        return RiddleMemory()

    def copy(self, learned: RiddleMemory) -> RiddleMemory:
        """The same once more."""
        return learned.copy()

    def encode(self, frame: Frame, reference: Reference, learned: RiddleMemory) -> CodedRanges:
        """The RANGE section of a frame. Some of its returns go to the learner, if there is one."""
        stream, learner = self._settings.stream, self._learner
        samples = None if learner is None else learner.samples_of(frame, expects=reference.expected is not None)
        coded, free = coded_ranges(self._coder(learned), frame, reference, stream, quick=True, samples=samples)
        if learner is not None and samples is not None:
            learner.take(samples, frame.points)
        # Without memory no frame refers to another, and an update is sent once. Who lost it asks for a key frame.
        told = learned.told if self._own.memory else self._told
        self._tells = told is not self._update
        self._told = learned.told = self._update
        name = bytes.fromhex(_name_of(self._current)) or bytes(_NAME_BYTES)
        return CodedRanges(with_step(stream.step, bytes([self._own.effort]) + name + coded), free)

    def take_offer(self) -> None:
        """Code with what was learned from now on, if the learner offers it."""
        learner, weights, own = self._learner, self._weights, self._own
        if learner is None or weights is None:
            return
        if learner.of != (weights.name, networks_of(weights, own.effort)[0].size, own.expects):
            self._learner = None  # another thread made it while settings changed: it learns something else
            return
        if (offer := learner.offered()) is not None:
            self._update, self._nets = offer.update, _nets_of(offer.weights, own.effort)

    def weight_sections(self, *, key: bool) -> list[Section]:
        """WEIGHTS sections of the message of the frame that was coded last: what its decoder lacks."""
        sections = []
        if key and self._weights is not None and self._weights.name not in shipped():
            sections.append(Section(SectionType.WEIGHTS, self._weights.data))
        if (key or self._tells) and self._update is not None:
            sections.append(Section(SectionType.WEIGHTS, self._update.data))
        return sections

    def learn(self, steps: int, budget_ms: float | None) -> int:
        """Train the network on the frames that were coded since this was called first; steps taken."""
        weights, own, learner = self._weights, self._own, self._learner
        if weights is None:
            return 0
        if learner is None:
            learner = self._learner = Learner(weights, networks_of(weights, own.effort), expects=own.expects)
        learner.key_interval = self._settings.stream.key_interval
        return learner.learn(steps, budget_ms)

    @property
    def _current(self) -> Weights | None:
        """The weights to code with."""
        return self._weights if self._update is None else self._update.weights

    def _coder(self, learned: RiddleMemory) -> entropy.PredictiveCoder:
        """The coder with the current networks. What it learned stays where only the weights are others."""
        used, nets, coder = learned.used, self._nets, learned.coder
        wanted = (_name_of(self._current), self._own.effort)
        if coder is None or used is None or not _goes_on(used, wanted):
            coder = entropy.PredictiveCoder(nets=nets)
        elif used != wanted and nets is not None:
            coder.change(nets)
        learned.coder, learned.used = coder, wanted
        return coder

    @property
    def learn_ms(self) -> float:
        """Milliseconds a frame for training, by the settings."""
        return 0.0 if self._weights is None else self._own.learn_ms

    @property
    def learned(self) -> dict[str, Any] | None:
        """What was learned in the stream; None before `learn` is called."""
        learner = self._learner
        return None if learner is None else learner.report()


class RiddleContent:
    """What `riddle` sends of a frame: planes and ranges with their reference, weights, and a filler."""

    def __init__(self, ranges: NetworkRanges) -> None:
        self._ranges, self._referring = ranges, Referring(ranges)

    def take(self, settings: InForce[RiddleSettings]) -> bool:
        """Takes settings; True: the next message must be a key message."""
        return self._referring.take(settings)

    def refer_to(self, indices: Set[int] | None) -> None:
        """Refer to the newest of these frames; None: to the frame before."""
        self._referring.refer_to(indices)

    def code(self, frame: Frame, *, key: bool) -> Coded:
        """All sections of a frame but the calibration."""
        self._ranges.take_offer()
        coded = self._referring.code(frame, key=key)
        sections = coded.sections + self._ranges.weight_sections(key=key)
        missing = _least_bytes(frame.valid) - _bytes_of(sections)
        if missing > 0:
            sections.append(Section(SectionType.FILLER, bytes(missing)))
        return coded._replace(sections=sections)


class RiddleEncoder:
    """Encoder of `riddle`. Raises SettingsError for weights that cannot be used."""

    def __init__(self, codec_id: int, settings: StreamSettings, stream_id: int) -> None:
        self._ranges = NetworkRanges(own_settings(RiddleSettings, settings))
        self._frames = FrameEncoder(codec_id, settings, stream_id, RiddleSettings, RiddleContent(self._ranges))

    def encode(self, frame: Frame, *, key: bool = False) -> list[Message]:
        """The frame's message. Raises LidarCodecError for a frame that contradicts itself."""
        return self._frames.encode(frame, key=key)

    def refer_to(self, indices: Set[int] | None) -> bool:
        """Refer to the newest of these frames; None: to the frame before."""
        return self._frames.refer_to(indices)

    def apply(self, settings: StreamSettings) -> bool:
        """Takes new settings; other weights, or another effort, begin with a key message."""
        return self._frames.apply(settings)

    def decoded_ranges(self) -> Ranges | None:
        """(64, W) uint16, the ranges of the last frame as a decoder gets them."""
        return self._frames.decoded_ranges()

    def flush(self) -> list[Message]:
        """Nothing: no frame is held back."""
        return self._frames.flush()

    def learn(self, steps: int, budget_ms: float | None = None) -> int:
        """Train the network on the frames that were coded since this was called first; steps taken. One other thread
        may call it. None without a network, and while there are too few samples."""
        return self._ranges.learn(steps, budget_ms)

    @property
    def learn_ms(self) -> float:
        """Milliseconds a frame that may be spent on learning where this runs live."""
        return self._ranges.learn_ms

    @property
    def learned(self) -> dict[str, Any] | None:
        """What was learned in the stream; None before `learn` is called."""
        return self._ranges.learned


def _least_bytes(valid: Mask) -> int:
    """How many bytes the sections of a frame with these returns have at least. valid: (64, W)."""
    return -(-int(np.count_nonzero(valid)) // RETURNS_PER_BYTE)


def _bytes_of(sections: Sequence[Section]) -> int:
    return sum(len(section.data) for section in sections)


def _weights_for(own: RiddleSettings) -> Weights | None:
    """Weights with networks for all frames, None where settings ask for none; of a file that is in no package only what
    is used, which is sent. Raises SettingsError."""
    if own.effort == EFFORTS[0]:
        return None
    try:
        weights = weights_of(own.weights)
        nets = networks_of(weights, own.effort)
    except LidarCodecError as error:
        raise SettingsError(str(error), "codec_settings.weights") from None
    return weights if weights.name in shipped() else weights_with(nets)


def _name_of(weights: Weights | None) -> str:
    return "" if weights is None else weights.name


def _nets_of(weights: Weights | None, effort: int) -> NativeNets | None:
    """Networks as the coder takes them. Raises UnknownNameError if there is none for a kind of frame."""
    return None if weights is None else native_nets(networks_of(weights, effort))


def _goes_on(used: tuple[str, int], wanted: tuple[str, int]) -> bool:
    """Whether a stream goes on with what was learned with other weights: they are for the same effort."""
    return used == wanted or (bool(used[0]) and bool(wanted[0]) and used[1] == wanted[1])


def _read_weights(settings: StreamSettings) -> Weights | None:
    return _weights_for(own_settings(RiddleSettings, settings))


CODEC = Codec(
    RiddleSettings, RiddleEncoder, SessionDecoder, knob=bound_knob(), layered=True, parts=True, files=_read_weights
)

"""The interface of a codec: an encoder, a decoder, and a model of its own settings."""

from __future__ import annotations

from collections.abc import Callable, Sequence, Set
from dataclasses import dataclass
from typing import Any, Generic, NamedTuple, Protocol, TypeVar, runtime_checkable

import numpy as np
import numpy.typing as npt
from pydantic import ConfigDict, ValidationError

from lidarcodec.codecs.rate_knob import RateKnob
from lidarcodec.errors import SettingsError, one_of, sentence_of
from lidarcodec.frame import Frame
from lidarcodec.message import Message
from lidarcodec.settings import Described, StreamSettings


class Encoder(Protocol):
    """Frames in, messages out. Holds the state of one stream; a new stream needs a new encoder."""

    def encode(self, frame: Frame, *, key: bool = False) -> list[Message]:
        """Messages that became complete with this frame; a key message when `key` is set or the interval is over."""

    def apply(self, settings: StreamSettings) -> bool:
        """Use new settings from the next frame on. True: the next message will be a key frame."""

    def flush(self) -> list[Message]:
        """Messages of frames that were held back."""


class Steering(Protocol):
    """Finds the quality setting at which a message of several frames has its target size."""

    def range_of(self, frames: Sequence[Frame], message: Message, code: Callable[[StreamSettings], bytes]) -> bytes:
        """The RANGE section of a message of these frames.

        message: the message without that section; code: gives the section for some settings
        """


@runtime_checkable
class Steered(Protocol):
    """An encoder that collects frames, and asks for its quality setting when a message has all of them."""

    def steer(self, steering: Steering | None) -> None:
        """Ask `steering` from now on; None: use the settings."""


@runtime_checkable
class Choosing(Protocol):
    """An encoder whose frames may refer to any of a few earlier ones."""

    def refer_to(self, indices: Set[int] | None) -> bool:
        """Refer to the newest of these frames from now on, to none if none of them is kept. None: to the frame before.
        False: frames of this codec refer to none, or only to the frame before."""


@runtime_checkable
class Layered(Protocol):
    """An encoder that knows what a decoder gets."""

    def decoded_ranges(self) -> npt.NDArray[np.uint16] | None:
        """(64, W) uint16, the ranges of the last frame as a decoder gets them; None of a codec without refinements."""


@runtime_checkable
class Learning(Protocol):
    """An encoder that can train on the frames that it coded. It does so only in calls of `learn`."""

    def learn(self, steps: int, budget_ms: float | None = None) -> int:
        """Take at most `steps` training steps, none begun after `budget_ms`; returns their number. Another thread may
        call it."""

    @property
    def learn_ms(self) -> float:
        """Milliseconds a frame that a live application may spend on `learn`, from its settings."""

    @property
    def learned(self) -> dict[str, Any] | None:
        """State of the training; None before `learn` is called."""


class Decoder(Protocol):
    """Messages in, frames out.

    Raises only errors of the DecodeError tree, on any input, and goes on with the next message.
    """

    def decode(self, message: Message) -> list[Frame]:
        """Frames that became complete with this message."""

    def flush(self) -> list[Frame]:
        """Frames that were held back."""


class CodecSettings(Described):
    """Base of the models of codecs' own settings. Frozen; unknown keys, and `true` for a number, are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, strict=True)


Own = TypeVar("Own", bound=CodecSettings)


def own_settings(model: type[Own], settings: StreamSettings) -> Own:
    """A codec's own settings out of `settings.codec_settings`.

    Raises SettingsError naming the key.
    """
    try:
        return model.model_validate(settings.codec_settings)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        field = f"codec_settings.{key}"
        if first["type"] == "extra_forbidden":
            known = model.model_fields
            text = f"codec {settings.codec} has no settings of its own, so no '{key}'"
            if known:
                text = f"codec {settings.codec} has no setting '{key}': {one_of(key, known)}"
            raise SettingsError(text, field) from None
        raise SettingsError(sentence_of(f"{field} of codec {settings.codec}", first), field) from None


@dataclass(frozen=True)
class InForce(Generic[Own]):
    """The current settings of an encoder, checked: those of the stream, and the codec's own."""

    stream: StreamSettings
    own: Own

    @classmethod
    def of(cls, model: type[Own], settings: StreamSettings, before: InForce[Own] | None = None) -> InForce[Own]:
        """The settings in force once `settings` are taken. before: those in force now, for the same codec.

        Raises SettingsError naming the key.
        """
        if before is not None and settings.codec_settings == before.stream.codec_settings:
            return cls(settings, before.own)
        return cls(settings, own_settings(model, settings))


class Others(NamedTuple):
    """Coders of frames of other sensors than the HDL-64E, of a codec that codes ranges apart from other planes."""

    encoder: Callable[[int, StreamSettings, int], Encoder]
    decoder: Callable[[int], Decoder]


class Codec(NamedTuple):
    """Entry of a codec for the table; its module has it as `CODEC`.

    settings: model of its own settings; encoder: of (codec id, settings, stream id); decoder: of (codec id);
    bounded: whether it can keep `max_error_m`; knob: what a target bitrate turns, None where nothing can
    isolated: whether live use gives it a process of its own, because it hands bytes to large libraries of others
    rolling: whether a thinned stream may begin at another column in each frame; not where a frame is predicted from the
        picture before
    layered: whether its frames can be bases (`base_error_m`)
    parts: whether it sends turns in parts (`framing=parts:N`)
    files: reads what settings name on this machine, as the encoder does; raises SettingsError
    others: encoder and decoder of frames of other sensors than the HDL-64E, of a codec of pictures
    """

    settings: type[CodecSettings]
    encoder: Callable[[int, StreamSettings, int], Encoder]
    decoder: Callable[[int], Decoder]
    bounded: bool = True
    knob: RateKnob | None = None
    isolated: bool = False
    rolling: bool = True
    layered: bool = False
    parts: bool = False
    files: Callable[[StreamSettings], object] | None = None
    others: Others | None = None

"""What every codec gives: an encoder, a decoder, and a model of its own settings."""

from __future__ import annotations

from typing import Protocol

from pydantic import BaseModel, ConfigDict

from lidarcodec.frame import Frame
from lidarcodec.message import Message
from lidarcodec.settings import StreamSettings


class Encoder(Protocol):
    """Frames in, messages out. Holds the state of one stream; throw it away to start afresh."""

    def encode(self, frame: Frame, *, key: bool = False) -> list[Message]:
        """Messages that became complete with this frame; a key message when `key` is set or the interval is over."""

    def apply(self, settings: StreamSettings) -> bool:
        """Take new settings from the next frame on. True: the next message will be a key frame."""

    def flush(self) -> list[Message]:
        """Messages of frames that were held back."""


class Decoder(Protocol):
    """Messages in, frames out.

    Raises only errors of the DecodeError tree, on any input, and goes on with the next message.
    """

    def decode(self, message: Message) -> list[Frame]:
        """Frames that became complete with this message."""

    def flush(self) -> list[Frame]:
        """Frames that were held back."""


class CodecSettings(BaseModel):
    """Base of the models of codecs' own settings. Frozen; unknown keys are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

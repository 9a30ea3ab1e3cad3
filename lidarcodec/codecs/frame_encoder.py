"""Encoder of a codec whose messages hold one frame each. It decides when a key message is due.

The sections of a frame are coded by a part of the codec, its `FrameContent`. `Independent` is the content of codecs
that code the ranges of each frame independently. Contents that refer to earlier frames are in `referring.py`.
"""

from __future__ import annotations

from collections.abc import Callable, Set
from typing import Generic, NamedTuple, Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

from lidarcodec.codecs.base import Encoder, InForce, Own
from lidarcodec.codecs.kept_frames import KeptFrames, TurnParts
from lidarcodec.errors import SettingsError
from lidarcodec.frame import Frame
from lidarcodec.message import Message, Section, SectionType
from lidarcodec.motion.history import MaskHistory
from lidarcodec.planes.calibrations import encode_calibration
from lidarcodec.planes.intensity import Quality
from lidarcodec.planes.sections import planes_beside
from lidarcodec.ranges.quantise import requantised
from lidarcodec.settings import StreamSettings


class Coded(NamedTuple):
    """The coded sections of a frame.

    sections: all except the calibration; needs: index of the frame that they refer to, or None
    ranges: gives (64, W) uint16, the ranges as a decoder gets them; None of a codec without refinements
    goes_on: whether the frame is a part of a turn that goes on from the part before
    """

    sections: list[Section]
    needs: int | None
    ranges: Callable[[], npt.NDArray[np.uint16]] | None = None
    goes_on: bool = False


class FrameContent(Protocol[Own]):
    """The part of an encoder that codes frames."""

    def take(self, settings: InForce[Own]) -> bool:
        """Follow these settings from the next frame on. True: the next message must be a key message.

        Raises SettingsError, and changes nothing then.
        """

    def code(self, frame: Frame, *, key: bool) -> Coded:
        """The sections of a frame. Those of a key message refer to no other frame.

        Raises LidarCodecError for a frame that contradicts itself. The next frame then does not refer to this one.
        """


@runtime_checkable
class Choosing(Protocol):
    """Content whose frames can refer to any of a few earlier ones."""

    def refer_to(self, indices: Set[int] | None) -> None:
        """Refer to the newest of these frames that is kept, to none without any. None: to the frame before."""


class FrameEncoder(Generic[Own]):
    """Frames to messages, one each. Holds the settings in force and when the last key message was.

    model: class of the codec's own settings; content: codes the frames
    plain_calibration: send the calibration table uncompressed

    Raises SettingsError.
    """

    def __init__(
        self,
        codec_id: int,
        settings: StreamSettings,
        stream_id: int,
        model: type[Own],
        content: FrameContent[Own],
        *,
        plain_calibration: bool = False,
    ) -> None:
        self.codec_id, self.stream_id = codec_id, stream_id
        self._model, self._content, self._plain_calibration = model, content, plain_calibration
        self._settings = InForce.of(model, settings)
        content.take(self._settings)
        self._since_key: int | None = None
        self._sensor: tuple[str, str] | None = None
        self._last_index = -1
        self._ranges: Callable[[], npt.NDArray[np.uint16]] | None = None

    def apply(self, settings: StreamSettings) -> bool:
        """Takes new settings from the next frame on. True: the next message will be a key message.

        Raises SettingsError, also for another codec, which needs a new encoder. Then nothing changes.
        """
        check_same_codec(self._settings.stream, settings)
        taken = InForce.of(self._model, settings, self._settings)
        if self._content.take(taken):
            self._since_key = None
        self._settings = taken
        return self._key_is_due()

    def refer_to(self, indices: Set[int] | None) -> bool:
        """As of `Choosing` in base.py."""
        content = self._content
        if isinstance(content, Choosing):
            content.refer_to(indices)
        return isinstance(content, Choosing)

    def encode(self, frame: Frame, *, key: bool = False) -> list[Message]:
        """The frame's message.

        Raises LidarCodecError for a frame that contradicts itself.
        """
        sensor = (frame.sensor.hash, frame.sensor.convention)
        within = frame.part.goes_on and self._since_key is not None  # a turn is not cut by a key message that is due
        key = key or (self._key_is_due() and not within) or sensor != self._sensor or frame.index <= self._last_index
        calibration = encode_calibration(frame.sensor, key, self._plain_calibration)
        coded = self._content.code(frame, key=key)
        self._ranges = coded.ranges
        self._since_key = 1 if key else (self._since_key or 0) + (not within)
        self._sensor, self._last_index = sensor, frame.index
        return [
            Message(
                codec=self.codec_id,
                stream_id=self.stream_id,
                frame_index=frame.index,
                stamp_ns=frame.stamp_ns,
                key=key,
                width=frame.width,
                packets=0 if frame.side is None else frame.side.packets,
                sections=(Section(SectionType.CALIBRATION, calibration), *coded.sections),
                needs=coded.needs,
                planes=not frame.sensor.is_hdl64e,
                goes_on=coded.goes_on,
                more=frame.part.more,
            )
        ]

    def decoded_ranges(self) -> npt.NDArray[np.uint16] | None:
        """The ranges of the last frame as a decoder gets them; None if its codec has no refinements."""
        return None if self._ranges is None else self._ranges()

    def flush(self) -> list[Message]:
        """Nothing: no frame is held back."""
        return []

    def _key_is_due(self) -> bool:
        return self._since_key is None or self._since_key >= self._settings.stream.key_interval


def check_same_codec(before: StreamSettings, after: StreamSettings) -> None:
    """Raise SettingsError if an encoder is given the settings of another codec."""
    if after.codec != before.codec:
        raise SettingsError(
            f"an encoder of codec {before.codec} cannot change to codec {after.codec}: create a new one", "codec"
        )


CodeRanges = Callable[[Frame, InForce[Own]], bytes]
"""How a codec writes the RANGE section of a frame: the ranges of its `valid` returns."""


class Independent(Generic[Own]):
    """Content of a codec that codes the ranges of each frame independently.

    code_ranges: gives the RANGE section; grouped_intensity: code intensities fast instead of small (intensity.py)
    mask_history: whether masks refer to masks since the last key message, by the codec's own settings
    layered: whether the codec quantises as ranges/quantise.py does, so that refinements of its ranges can be coded
    """

    _settings: InForce[Own]

    def __init__(
        self,
        code_ranges: CodeRanges[Own],
        *,
        grouped_intensity: bool = False,
        mask_history: Callable[[Own], bool] = lambda _: False,
        layered: bool = False,
    ) -> None:
        self._code_ranges, self._grouped_intensity, self._with_history = code_ranges, grouped_intensity, mask_history
        self._layered = layered
        self._turn = TurnParts()
        self._masks = KeptFrames[MaskHistory](MaskHistory.copy)
        """The masks since the last message that needs no other, up to each of the last frames."""

    def take(self, settings: InForce[Own]) -> bool:
        """Use new settings; they never need a key message."""
        self._settings = settings
        return False

    def refer_to(self, indices: Set[int] | None) -> None:
        """Refer to the newest of these frames; None: to the frame before."""
        self._masks.refer_to(indices)

    def code(self, frame: Frame, *, key: bool) -> Coded:
        """Ranges and planes of a frame."""
        settings = self._settings
        with_history = self._with_history(settings.own)
        goes_on = self._turn.goes_on(frame, key=key)
        found = self._masks.reference() if with_history and not key and not goes_on else None
        needs, masks = found or (None, None)
        if goes_on:
            needs, masks = frame.index - 1, self._masks.go_on(frame.index - 1)
        elif needs is None:
            self._masks.forget()
        previous = None if masks is None else masks.before(frame.azimuth, frame.sensor)
        quality = Quality.of(settings.stream)
        memory, grouped = self._turn.memory(frame, goes_on=goes_on), self._grouped_intensity
        with planes_beside(frame, quality, previous, grouped_intensity=grouped, memory=memory) as planes:
            sections = [Section(SectionType.RANGE, self._ranges(frame)), *planes()]
        if with_history:
            masks = masks or MaskHistory()
            masks.remember(frame.valid, frame.azimuth, frame.sensor)
            self._masks.put(frame.index, masks)
        step = settings.stream.step
        self._turn.coded(frame)
        return Coded(sections, needs, (lambda: requantised(frame, step)) if self._layered else None, goes_on)

    def _ranges(self, frame: Frame) -> bytes:
        return self._code_ranges(frame, self._settings)


def independent_encoder(
    model: type[Own],
    code_ranges: CodeRanges[Own],
    *,
    grouped_intensity: bool = False,
    mask_history: Callable[[Own], bool] = lambda _: False,
    layered: bool = False,
) -> Callable[[int, StreamSettings, int], Encoder]:
    """Function that makes encoders of a codec that codes the ranges of each frame independently.

    All arguments but `model` are those of `Independent`.
    """

    def make(codec_id: int, settings: StreamSettings, stream_id: int) -> Encoder:
        content = Independent(
            code_ranges, grouped_intensity=grouped_intensity, mask_history=mask_history, layered=layered
        )
        return FrameEncoder(codec_id, settings, stream_id, model, content)

    return make

"""Encoder and decoder of codecs whose messages hold one frame each. A codec adds how it writes ranges.

Every message can be decoded once its calibration is known: a lost one costs one frame and nothing more. Key messages
carry the calibration table; the others its hash. Only with `mask_history` a mask refers to the masks sent since the
last key message: a lost message then costs all frames up to the next one.
"""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
import numpy.typing as npt

from lidarcodec.errors import MissingReferenceError, SectionError, SettingsError, UnsupportedVersionError
from lidarcodec.frame import Frame
from lidarcodec.message import Message, Section, SectionType
from lidarcodec.motion.history import MaskHistory
from lidarcodec.planes.calibrations import SensorBook, encode_calibration
from lidarcodec.planes.intensity import Quality
from lidarcodec.planes.sections import DecodeMask, EncodeMask, Planes, decode_planes, encode_planes
from lidarcodec.sensor_model import SensorModel
from lidarcodec.settings import StreamSettings

Ranges = npt.NDArray[np.uint16]
Mask = npt.NDArray[np.bool_]


class FrameEncoder(ABC):
    """Frames to messages, one each; holds the settings and when the last key message was."""

    plain_calibration = False
    grouped_intensity = False
    """Whether intensities are coded quickly instead of small (intensity.py)."""

    def __init__(self, codec_id: int, settings: StreamSettings, stream_id: int) -> None:
        self.codec_id, self.stream_id, self.settings = codec_id, stream_id, settings
        self._since_key: int | None = None
        self._sensor: tuple[str, str] | None = None
        self._last_index = -1

    def apply(self, settings: StreamSettings) -> bool:
        """Takes new settings from the next frame on. True: the next message will be a key message.

        Raises SettingsError for another codec: that takes another encoder.
        """
        if settings.codec != self.settings.codec:
            raise SettingsError(f"an encoder of {self.settings.codec} cannot become {settings.codec}", "codec")
        self.settings = settings
        return self._key_is_due()

    def encode(self, frame: Frame, *, key: bool = False) -> list[Message]:
        """The frame's message.

        Raises LidarCodecError for a frame that contradicts itself.
        """
        sensor = (frame.sensor.hash, frame.sensor.convention)
        key = key or self._key_is_due() or sensor != self._sensor or frame.index <= self._last_index
        calibration = encode_calibration(frame.sensor, key, self.plain_calibration)
        sections, needs = self._sections(frame, key)
        self._since_key = 1 if key else (self._since_key or 0) + 1
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
                sections=(Section(SectionType.CALIBRATION, calibration), *sections),
                needs=needs,
            )
        ]

    def flush(self) -> list[Message]:
        """Nothing: no frame is held back."""
        return []

    def _key_is_due(self) -> bool:
        return self._since_key is None or self._since_key >= self.settings.key_interval

    @abstractmethod
    def _sections(self, frame: Frame, key: bool) -> tuple[list[Section], int | None]:
        """Sections beside the calibration, and the index of the frame that they refer to."""


class IntraEncoder(FrameEncoder):
    """The encoder of a codec whose ranges refer to no other frame's."""

    def __init__(self, codec_id: int, settings: StreamSettings, stream_id: int) -> None:
        super().__init__(codec_id, settings, stream_id)
        self._history: MaskHistory | None = None

    def _sections(self, frame: Frame, key: bool) -> tuple[list[Section], int | None]:
        history = self._history if self._mask_history() and not key else None
        needs = None if history is None else self._last_index
        encode_mask = self._mask_in_stream() if frame.keep is None else None
        planes = encode_planes(
            frame,
            Quality.of(self.settings),
            None if history is None or encode_mask is not None else history.before(frame.azimuth, frame.sensor),
            grouped_intensity=self.grouped_intensity,
            encode_mask=encode_mask,
        )
        sections = [Section(SectionType.RANGE, self._range(frame, frame.valid)), *planes]
        self._history = None
        if self._mask_history():
            self._history = history or MaskHistory()
            self._history.remember(frame.valid, frame.azimuth, frame.sensor)
        return sections, needs

    def _mask_history(self) -> bool:
        """Whether masks may refer to those before."""
        return False

    def _mask_in_stream(self) -> EncodeMask | None:
        """What codes masks with memory, if anything does."""
        return None

    @abstractmethod
    def _range(self, frame: Frame, valid: Mask) -> bytes:
        """The RANGE section. valid: (64, W) bool, the returns that are sent."""


class IntraDecoder(ABC):
    """Messages to frames, one each; holds the sensors that key messages described."""

    def __init__(self, codec_id: int) -> None:
        self.codec_id = codec_id
        self._sensors = SensorBook()
        self._history = MaskHistory()
        self._last: tuple[int, int] | None = None
        self._unseen: list[tuple[Planes, SensorModel]] = []

    def decode(self, message: Message) -> list[Frame]:
        """The message's frame.

        Raises DecodeError; MissingReferenceError when a key message has to come first.
        """
        if message.codec != self.codec_id:
            raise UnsupportedVersionError(f"a message of codec {message.codec} for a decoder of {self.codec_id}")
        if message.frame_count != 1:
            raise SectionError(f"a message of {message.frame_count} frames of a codec that sends one each")
        sensor = self._sensors.sensor_of(message)
        planes = self._planes(message, sensor)
        frame = frame_of(message, sensor, planes, self._ranges(message, planes, sensor))
        if message.needs is None:
            self._history, self._unseen = MaskHistory(), []
        self._unseen.append((planes, sensor))
        self._last = (message.stream_id, message.frame_index)
        return [frame]

    def flush(self) -> list[Frame]:
        """Nothing: no frame is held back."""
        return []

    def _planes(self, message: Message, sensor: SensorModel) -> Planes:
        if message.needs is None:
            return decode_planes(message, sensor, None, self._begin(message, sensor))
        if self._last != (message.stream_id, message.needs):
            raise MissingReferenceError(
                f"frame {message.frame_index} needs frame {message.needs}, which was not decoded: ask for a key frame",
                message.needs,
            )
        for planes, of in self._unseen:  # brought in only now, so that streams without history pay nothing for it
            self._history.remember(planes.valid, planes.azimuth, of)
        self._unseen = []
        return decode_planes(message, sensor, self._history, self._begin(message, sensor))

    def _begin(self, message: Message, sensor: SensorModel) -> DecodeMask | None:
        """Begin a message that can be decoded; what decodes masks with memory, if anything does."""
        return None

    @abstractmethod
    def _ranges(self, message: Message, planes: Planes, sensor: SensorModel) -> Ranges:
        """(64, W) uint16, the ranges of a message: not 0 where `planes.valid`, 0 elsewhere.

        Raises SectionError.
        """


class ReturnsDecoder(IntraDecoder):
    """The decoder of a codec that writes the ranges of returns one after another."""

    def _ranges(self, message: Message, planes: Planes, sensor: SensorModel) -> Ranges:
        ranges = np.zeros(planes.valid.shape, np.uint16)
        ranges[planes.valid] = self._returns(message.section(SectionType.RANGE), planes.valid, sensor)
        return ranges

    @abstractmethod
    def _returns(self, data: bytes, valid: Mask, sensor: SensorModel) -> Ranges:
        """(N,) uint16, ranges of the N returns in row order, none of them 0, out of the RANGE section.

        valid: (64, W) bool. Raises SectionError.
        """


def frame_of(message: Message, sensor: SensorModel, planes: Planes, ranges: Ranges) -> Frame:
    """The frame of a message of one frame. ranges: (64, W) uint16."""
    return Frame(
        index=message.frame_index,
        stamp_ns=message.stamp_ns,
        range=ranges,
        intensity=planes.intensity,
        azimuth=planes.azimuth,
        fired=planes.fired,
        sensor=sensor,
        side=planes.side,
        pose=planes.pose,
    )

"""Shared parts of decoders for messages of one frame, and the decoder of codecs that code each frame independently.

Every message can be decoded once its calibration is known, unless its mask refers to those before: a lost message
then costs all frames up to the next key message.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from lidarcodec.codecs.base import Decoder
from lidarcodec.errors import MissingReferenceError, SectionError, UnsupportedVersionError
from lidarcodec.frame import Frame
from lidarcodec.message import Message, SectionType
from lidarcodec.motion.history import MaskHistory
from lidarcodec.planes.calibrations import SensorBook
from lidarcodec.planes.sections import Planes, decode_planes
from lidarcodec.sensor_model import SensorModel

Ranges = npt.NDArray[np.uint16]
Mask = npt.NDArray[np.bool_]

DecodeRanges = Callable[[bytes, Mask, SensorModel], Ranges]
"""Reads a RANGE section, for (64, W) bool returns: (N,) uint16, their ranges in row order, none of them 0.

Raises SectionError or TruncatedError."""


class MaskChain:
    """The masks since the last independent message, and the index of the last decoded frame."""

    def __init__(self) -> None:
        self._history = MaskHistory()
        self._last: tuple[int, int] | None = None
        self._unseen: list[tuple[Planes, SensorModel]] = []

    def before(self, message: Message) -> MaskHistory | None:
        """The masks that a message may refer to; None if it needs no other.

        Raises MissingReferenceError if the frame that it needs was not the last one decoded.
        """
        if message.needs is None:
            return None
        if self._last != (message.stream_id, message.needs):
            raise missing_reference(message, message.needs)
        for planes, sensor in self._unseen:  # added only when needed: no cost for streams without history
            self._history.remember(planes.valid, planes.azimuth, sensor)
        self._unseen = []
        return self._history

    def cut(self) -> None:
        """Refuse messages that need another until an independent one is decoded."""
        self._last = None

    def take(self, message: Message, planes: Planes, sensor: SensorModel) -> None:
        """Add a decoded message."""
        if message.needs is None:
            self._history, self._unseen = MaskHistory(), []
        self._unseen.append((planes, sensor))
        self._last = (message.stream_id, message.frame_index)


class IndependentDecoder:
    """Decoder of a codec that codes the ranges of each frame independently."""

    def __init__(self, codec_id: int, decode_ranges: DecodeRanges) -> None:
        self.codec_id = codec_id
        self._decode_ranges = decode_ranges
        self._sensors, self._masks = SensorBook(), MaskChain()

    def decode(self, message: Message) -> list[Frame]:
        """The message's frame.

        Raises DecodeError; MissingReferenceError when a key message has to come first.
        """
        check_single(message, self.codec_id)
        sensor = self._sensors.sensor_of(message)
        planes = decode_planes(message, sensor, self._masks.before(message))
        ranges = np.zeros(planes.valid.shape, np.uint16)
        ranges[planes.valid] = self._ranges(message.section(SectionType.RANGE), planes.valid, sensor)
        frame = frame_of(message, sensor, planes, ranges)
        self._masks.take(message, planes, sensor)
        return [frame]

    def flush(self) -> list[Frame]:
        """Nothing: no frame is held back."""
        return []

    def _ranges(self, data: bytes, valid: Mask, sensor: SensorModel) -> Ranges:
        return self._decode_ranges(data, valid, sensor)


def independent_decoder(decode_ranges: DecodeRanges) -> Callable[[int], Decoder]:
    """A function that makes decoders of a codec that codes the ranges of each frame independently."""
    return lambda codec_id: IndependentDecoder(codec_id, decode_ranges)


def check_single(message: Message, codec_id: int) -> None:
    """Raise UnsupportedVersionError or SectionError unless it is a message of one frame of that codec."""
    if message.codec != codec_id:
        raise UnsupportedVersionError(f"a message of codec {message.codec} for a decoder of {codec_id}")
    if message.frame_count != 1:
        raise SectionError(f"a message of {message.frame_count} frames of a codec that sends one each")


def missing_reference(message: Message, needs: int) -> MissingReferenceError:
    """The error for a message that needs a frame which was not decoded."""
    return MissingReferenceError(
        f"frame {message.frame_index} needs frame {needs}, which was not decoded: ask for a key frame", needs
    )


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

"""Decoder of codecs whose ranges refer to frames since the last key message: the way back of `referring.py`."""

from __future__ import annotations

from typing import Final, Protocol

import numpy as np
import numpy.typing as npt

from lidarcodec.codecs.frame_decoder import MaskChain, check_single, frame_of
from lidarcodec.entropy import KnownColumns, MaskStream
from lidarcodec.errors import SectionError
from lidarcodec.frame import Frame
from lidarcodec.message import Message, SectionType
from lidarcodec.motion.history import StreamHistory
from lidarcodec.motion.motion import Motion, decode_motion
from lidarcodec.motion.warp import beam_rows
from lidarcodec.planes.calibrations import SensorBook
from lidarcodec.planes.sections import Planes, decode_planes
from lidarcodec.sensor_model import SensorModel

Ranges = npt.NDArray[np.uint16]
Mask = npt.NDArray[np.bool_]


class RangeDecoder(Protocol):
    """How such a codec reads ranges."""

    def reset(self) -> None:
        """Forget what was learned since the last message that needs no other."""

    def begin(self, message: Message, planes: Planes) -> None:
        """Take what a message says beside its ranges. Raises SectionError or TruncatedError."""

    def columns_before(self, data: bytes) -> int | None:
        """How many columns before it a RANGE section refers to; None for a whole frame, and without returns.

        Raises SectionError or TruncatedError.
        """

    def decode(
        self, data: bytes, planes: Planes, sensor: SensorModel, expected: Ranges | None, edge: KnownColumns | None
    ) -> Ranges:
        """(64, W) uint16 of a RANGE section, not 0 where `planes.valid`, 0 elsewhere; expected, edge: as it was coded.

        Raises SectionError or TruncatedError.
        """


class ReferringDecoder:
    """Messages to frames, one each. ranges: reads the RANGE section."""

    def __init__(self, codec_id: int, ranges: RangeDecoder) -> None:
        self.codec_id = codec_id
        self._ranges: Final = ranges
        self._sensors, self._masks = SensorBook(), MaskChain()
        self._mask_stream: Final = MaskStream()
        self._sent: Final = StreamHistory()
        self._motion: Motion | None = None

    def decode(self, message: Message) -> list[Frame]:
        """The message's frame.

        Raises DecodeError; MissingReferenceError when a key message has to come first.
        """
        check_single(message, self.codec_id)
        sensor = self._sensors.sensor_of(message)
        history = self._masks.before(message)
        self._masks.cut()  # a message that fails halfway has taught something else than its encoder learned
        if message.needs is None:
            self._forget()
        expected: Ranges | None = None
        known = not message.has(SectionType.MOTION)

        def expectation(azimuth: Ranges, fired: Mask) -> Ranges | None:
            """The expected ranges, which a mask may need before the other planes are known; computed once."""
            nonlocal expected, known
            if not known:
                motion = self._motion_of(message)
                expected, known = self._sent.expected(motion, azimuth, fired, sensor), True
            return expected

        def decode_mask(data: bytes, azimuth: Ranges, fired: Mask) -> Mask:
            foreseen = expectation(azimuth, fired)
            motion = None if foreseen is None or self._motion is None else self._motion.numbers
            return self._mask_stream.decode(data, azimuth, fired, beam_rows(sensor), foreseen, motion)

        planes = decode_planes(message, sensor, history, decode_mask)
        self._ranges.begin(message, planes)
        ranges = self._decoded(message, planes, sensor, expectation(planes.azimuth, planes.fired))
        frame = frame_of(message, sensor, planes, ranges)
        self._masks.take(message, planes, sensor)
        return [frame]

    def flush(self) -> list[Frame]:
        """Nothing: no frame is held back."""
        return []

    def _forget(self) -> None:
        self._ranges.reset()
        self._sent.forget()
        self._mask_stream.forget()
        self._motion = None

    def _motion_of(self, message: Message) -> Motion:
        data = message.section(SectionType.MOTION)
        if data:
            self._motion = decode_motion(data)
        elif self._motion is None:
            raise SectionError("a motion as before, and there was none")
        return self._motion

    def _decoded(self, message: Message, planes: Planes, sensor: SensorModel, expected: Ranges | None) -> Ranges:
        data = message.section(SectionType.RANGE)
        columns = self._ranges.columns_before(data)
        edge = None if columns is None else self._sent.edge_of(columns)
        ranges = self._ranges.decode(data, planes, sensor, expected, edge)
        if edge is None:
            self._sent.forget_edge()
        else:
            self._sent.remember_edge(ranges, planes.azimuth, planes.fired, expected)
        self._sent.remember(ranges, planes.azimuth, planes.fired, sensor, slab=edge is not None)
        return ranges

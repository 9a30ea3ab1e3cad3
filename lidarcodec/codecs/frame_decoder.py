"""Decoders of messages of one frame, on the native core's decoder of a stream (native/src/session).

The session reads all planes, and the ranges of the codecs that it knows. Side information is read here, and by
`IndependentDecoder` the ranges of codecs whose pictures the libraries of an extra open.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from lidarcodec import _native, entropy
from lidarcodec.codecs.base import Decoder
from lidarcodec.entropy.zstd_frames import decompress
from lidarcodec.errors import MissingReferenceError, UnsupportedVersionError
from lidarcodec.frame import Frame, Part
from lidarcodec.message import Message, SectionType
from lidarcodec.network.shelf import shipped_file
from lidarcodec.planes.calibrations import sensor_of
from lidarcodec.planes.lattice_section import inflated
from lidarcodec.planes.sections import DecodeSide, side_of
from lidarcodec.sensor_model import SensorModel
from lidarcodec.side import SideInfo

Ranges = npt.NDArray[np.uint16]
Mask = npt.NDArray[np.bool_]

DecodeRanges = Callable[[bytes, Mask, SensorModel], Ranges]
"""Reads a RANGE section, for (64, W) bool returns: (N,) uint16, their ranges in row order, none of them 0.

Raises SectionError or TruncatedError."""


@dataclass(frozen=True, eq=False)
class Planes:
    """What a session gives of a frame; W columns.

    ranges: (64, W) uint16, zeros where the session does not read them; intensity: (64, W) uint8
    azimuth: (2, W) uint16; fired: (2, W) bool; valid: (64, W) bool, returns that were sent
    pose: (4, 4) float64 or None; side: None if the message has none
    """

    ranges: Ranges
    intensity: npt.NDArray[np.uint8]
    azimuth: Ranges
    fired: Mask
    valid: Mask
    pose: npt.NDArray[np.float64] | None
    sensor: SensorModel
    side: SideInfo | None

    def frame(self, message: Message) -> Frame:
        """The frame of the message that they come from."""
        return Frame(
            index=message.frame_index,
            stamp_ns=message.stamp_ns,
            range=self.ranges,
            intensity=self.intensity,
            azimuth=self.azimuth,
            fired=self.fired,
            sensor=self.sensor,
            side=self.side,
            pose=self.pose,
            part=Part(message.goes_on, message.more),
        )


class PlaneReader:
    """Reads the planes of the messages of a stream. reads_ranges: whether the caller reads their ranges."""

    def __init__(self, codec_id: int, *, reads_ranges: bool, decode_side: DecodeSide = entropy.decode_side) -> None:
        self._codec_id: Final = codec_id
        self._decode_side: Final = decode_side
        self._session: Final = _native.Session(decompress, inflated, shipped_file, reads_ranges)

    def read(self, message: Message) -> Planes:
        """The planes of a message of one frame.

        Raises DecodeError; MissingReferenceError when a key message has to come first.
        """
        check_codec(message, self._codec_id)
        ranges, intensity, azimuth, fired, returns, moved, described = self._session.decode(message)
        try:
            side = side_of(message, self._decode_side)
        except BaseException:
            self.cut()
            raise
        pose = None if moved is None else np.vstack([moved, [0.0, 0.0, 0.0, 1.0]])
        valid, halves = returns.view(np.bool_), fired.view(np.bool_)
        return Planes(ranges, intensity, azimuth, halves, valid, pose, sensor_of(*described), side)

    def cut(self) -> None:
        """Refuse messages that need another until one that needs none is read: the last one could not be used."""
        self._session.cut()


class SessionDecoder:
    """Decoder of a codec that the session reads as a whole."""

    def __init__(self, codec_id: int, decode_side: DecodeSide = entropy.decode_side) -> None:
        self.codec_id = codec_id
        self._planes = PlaneReader(codec_id, reads_ranges=False, decode_side=decode_side)

    def decode(self, message: Message) -> list[Frame]:
        """The message's frame.

        Raises DecodeError; MissingReferenceError when a key message has to come first.
        """
        planes = self._planes.read(message)
        return [planes.frame(message)]

    def flush(self) -> list[Frame]:
        """Nothing: no frame is held back."""
        return []


class IndependentDecoder:
    """Decoder of a codec that codes the ranges of each frame independently, as a picture."""

    def __init__(self, codec_id: int, decode_ranges: DecodeRanges) -> None:
        self.codec_id = codec_id
        self._decode_ranges = decode_ranges
        self._planes = PlaneReader(codec_id, reads_ranges=True)

    def decode(self, message: Message) -> list[Frame]:
        """The message's frame.

        Raises DecodeError; MissingReferenceError when a key message has to come first.
        """
        planes = self._planes.read(message)
        try:
            planes.ranges[planes.valid] = self._decode_ranges(
                message.section(SectionType.RANGE), planes.valid, planes.sensor
            )
        except BaseException:
            self._planes.cut()
            raise
        return [planes.frame(message)]

    def flush(self) -> list[Frame]:
        """Nothing: no frame is held back."""
        return []


def independent_decoder(decode_ranges: DecodeRanges) -> Callable[[int], Decoder]:
    """A function that makes decoders of a codec that codes the ranges of each frame independently, as a picture."""
    return lambda codec_id: IndependentDecoder(codec_id, decode_ranges)


def check_codec(message: Message, codec_id: int) -> None:
    """Raise UnsupportedVersionError unless it is a message of that codec."""
    if message.codec != codec_id:
        raise UnsupportedVersionError(
            f"this decoder is for codec {codec_id}, but the message has codec {message.codec}"
        )


def missing_reference(message: Message, needs: int) -> MissingReferenceError:
    """The error for a message that needs a frame which was not decoded."""
    return MissingReferenceError(
        f"frame {message.frame_index} needs frame {needs}, which was not decoded: ask for a key frame", needs
    )

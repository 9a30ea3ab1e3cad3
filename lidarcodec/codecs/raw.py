"""`raw`: every plane as it is, little endian, for readers that want nothing but a loop (docs/wire-format.md, "raw").

Ranges are always exact. It shows what the others save, and carries frames where bits cost nothing.
"""

from __future__ import annotations

import struct
from typing import Final

import numpy as np
import numpy.typing as npt

from lidarcodec.codecs.base import Codec, CodecSettings, Encoder, InForce
from lidarcodec.codecs.frame_decoder import check_single, frame_of
from lidarcodec.codecs.frame_encoder import Coded, FrameEncoder
from lidarcodec.errors import SectionError
from lidarcodec.frame import Frame
from lidarcodec.message import Message, Section, SectionType
from lidarcodec.planes.calibrations import SensorBook
from lidarcodec.planes.intensity import Quality, reduced
from lidarcodec.planes.sections import (
    Planes,
    check_unfired,
    decode_pose,
    fired_cells,
    pose_sections,
    position_sections,
    side_of,
)
from lidarcodec.sensor_model import SensorModel
from lidarcodec.settings import StreamSettings
from lidarcodec.side import SideInfo
from lidarcodec.units import AZIMUTH_TURN, BLOCK_BYTES, BLOCKS_PER_PACKET, LASERS, LASERS_PER_BLOCK

Ranges = npt.NDArray[np.uint16]

_SIDE_HEAD: Final = struct.Struct("<HII")


class RawSettings(CodecSettings):
    """`raw` has no settings of its own."""


def _image(data: bytes, dtype: str, rows: int, width: int, what: str) -> npt.NDArray[np.generic]:
    wanted = rows * width * np.dtype(dtype).itemsize
    if len(data) != wanted:
        raise SectionError(f"a raw {what} section of {len(data)} bytes, not {wanted}")
    return np.frombuffer(data, dtype).reshape(rows, width)


def _side_parts(head: tuple[int, int, int], packets: int) -> list[tuple[str, str, tuple[int, ...]]]:
    layouts, irregular, second = head
    return [
        ("packet_ns", "<i8", (packets,)),
        ("gps_us", "<u4", (packets,)),
        ("status", "u1", (packets, 2)),
        ("layout", "<u2", (packets,)),
        ("layouts", "u1", (layouts, BLOCKS_PER_PACKET)),
        ("irregular", "u1", (irregular, BLOCK_BYTES)),
        ("second", "u1", (second, LASERS_PER_BLOCK * 3)),
    ]


def _encode_side(side: SideInfo) -> bytes:
    head = (len(side.layouts), len(side.irregular), len(side.second))
    parts = [_SIDE_HEAD.pack(*head)]
    parts += [getattr(side, name).astype(dtype).tobytes() for name, dtype, _ in _side_parts(head, side.packets)]
    return b"".join(parts)


def _decode_side(data: bytes, packets: int) -> SideInfo:
    if len(data) < _SIDE_HEAD.size:
        raise SectionError(f"a raw side section of {len(data)} bytes ends within its head")
    parts = _side_parts(_SIDE_HEAD.unpack_from(data), packets)
    sizes = [int(np.prod(shape, dtype=np.int64)) * np.dtype(dtype).itemsize for _, dtype, shape in parts]
    if len(data) != _SIDE_HEAD.size + sum(sizes):
        raise SectionError(f"a raw side section of {len(data)} bytes, not {_SIDE_HEAD.size + sum(sizes)}")
    at, arrays = _SIDE_HEAD.size, {}
    for (name, dtype, shape), size in zip(parts, sizes, strict=True):
        native = np.dtype(dtype).newbyteorder("=")
        arrays[name] = np.frombuffer(data[at : at + size], dtype).reshape(shape).astype(native)
        at += size
    return SideInfo(
        packet_ns=arrays["packet_ns"],
        gps_us=arrays["gps_us"],
        status=arrays["status"],
        layouts=arrays["layouts"],
        layout=arrays["layout"],
        irregular=arrays["irregular"],
        second=arrays["second"],
    )


class RawContent:
    """What `raw` sends of a frame."""

    _settings: InForce[RawSettings]

    def take(self, settings: InForce[RawSettings]) -> bool:
        """Takes settings; no frame needs a key message for them."""
        self._settings = settings
        return False

    def code(self, frame: Frame, *, key: bool) -> Coded:
        """All planes of a frame, which refer to no other frame."""
        check_unfired(frame, fired_cells(frame.fired, frame.sensor))
        if int(frame.azimuth.max(initial=0)) >= AZIMUTH_TURN:
            raise SectionError("a rotation of a full turn or more")
        valid, quality = frame.valid, Quality.of(self._settings.stream)
        halves = frame.fired[0] | frame.fired[1] << np.uint8(1)
        sections = [
            Section(SectionType.RANGE, np.where(valid, frame.range, np.uint16(0)).astype("<u2").tobytes()),
            Section(SectionType.AZIMUTH, frame.azimuth.astype("<u2").tobytes() + halves.tobytes()),
        ]
        if quality.levels:
            intensity = frame.intensity
            if not quality.lossless:
                intensity = reduced(frame, quality)
            elif frame.keep is not None:
                intensity = np.where(valid, intensity, np.uint8(0))
            sections.append(Section(SectionType.INTENSITY, intensity.tobytes()))
        if frame.side is not None:
            sections.append(Section(SectionType.SIDE, _encode_side(frame.side)))
        return Coded(sections + position_sections(frame) + pose_sections(frame), None)


def _encoder(codec_id: int, settings: StreamSettings, stream_id: int) -> Encoder:
    return FrameEncoder(codec_id, settings, stream_id, RawSettings, RawContent(), plain_calibration=True)


class RawDecoder:
    """Decoder of `raw`."""

    def __init__(self, codec_id: int) -> None:
        self.codec_id = codec_id
        self._sensors = SensorBook()

    def decode(self, message: Message) -> list[Frame]:
        """The message's frame.

        Raises DecodeError; MissingReferenceError when a key message has to come first.
        """
        check_single(message, self.codec_id)
        sensor = self._sensors.sensor_of(message)
        planes, ranges = _decode_planes(message, sensor)
        return [frame_of(message, sensor, planes, ranges)]

    def flush(self) -> list[Frame]:
        """Nothing: no frame is held back."""
        return []


def _decode_planes(message: Message, sensor: SensorModel) -> tuple[Planes, Ranges]:
    width = message.width
    ranges = _image(message.section(SectionType.RANGE), "<u2", LASERS, width, "range").astype(np.uint16)
    angles = message.section(SectionType.AZIMUTH)
    azimuth = _image(angles[: 4 * width], "<u2", 2, width, "azimuth").astype(np.uint16)
    halves = _image(angles[4 * width :], "u1", 1, width, "azimuth")[0].astype(np.uint8)
    if width and (int(azimuth.max()) >= AZIMUTH_TURN or int(halves.max()) > 3):
        raise SectionError("a raw azimuth section with an azimuth beyond 35999 or an unknown half")
    fired = np.stack([halves & 1, halves >> 1]).astype(np.bool_)
    intensity = np.zeros((LASERS, width), np.uint8)
    if message.has(SectionType.INTENSITY):
        coded = message.section(SectionType.INTENSITY)
        intensity = _image(coded, "u1", LASERS, width, "intensity").astype(np.uint8)
    valid = ranges.astype(np.bool_)
    unfired = ~fired_cells(fired, sensor)
    if (valid & unfired).any() or intensity[unfired].any():
        raise SectionError("a raw message with returns in cells that were not fired")
    return Planes(valid, intensity, azimuth, fired, side_of(message, _decode_side), decode_pose(message)), ranges


CODEC = Codec(RawSettings, _encoder, RawDecoder)

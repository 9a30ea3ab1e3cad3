"""`raw`: every plane as it is, little endian, for readers that want nothing but a loop (docs/wire-format.md, "raw").

Ranges are always exact. It shows what the others save, and carries frames where bits cost nothing.
"""

from __future__ import annotations

import struct
from typing import Final

import numpy as np
import numpy.typing as npt

from lidarcodec.codecs.base import Codec, CodecSettings
from lidarcodec.codecs.intra import IntraEncoder, ReturnsDecoder
from lidarcodec.errors import SectionError
from lidarcodec.frame import Frame
from lidarcodec.message import Message, Section, SectionType
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
from lidarcodec.side import SideInfo
from lidarcodec.units import AZIMUTH_TURN, BLOCK_BYTES, BLOCKS_PER_PACKET, LASERS, LASERS_PER_BLOCK

Ranges = npt.NDArray[np.uint16]
Mask = npt.NDArray[np.bool_]

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


class RawEncoder(IntraEncoder):
    """Encoder of `raw`."""

    plain_calibration = True

    def _sections(self, frame: Frame, key: bool) -> tuple[list[Section], int | None]:
        check_unfired(frame, fired_cells(frame.fired, frame.sensor))
        if int(frame.azimuth.max(initial=0)) >= AZIMUTH_TURN:
            raise SectionError("a rotation of a full turn or more")
        valid, quality = frame.valid, Quality.of(self.settings)
        halves = frame.fired[0] | frame.fired[1] << np.uint8(1)
        sections = [
            Section(SectionType.RANGE, self._range(frame, valid)),
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
        return sections + position_sections(frame) + pose_sections(frame), None

    def _range(self, frame: Frame, valid: Mask) -> bytes:
        return np.where(valid, frame.range, np.uint16(0)).astype("<u2").tobytes()


class RawDecoder(ReturnsDecoder):
    """Decoder of `raw`."""

    def _planes(self, message: Message, sensor: SensorModel) -> Planes:
        width = message.width
        ranges = _image(message.section(SectionType.RANGE), "<u2", LASERS, width, "range")
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
        return Planes(valid, intensity, azimuth, fired, side_of(message, _decode_side), decode_pose(message))

    def _returns(self, data: bytes, valid: Mask, sensor: SensorModel) -> Ranges:
        return np.frombuffer(data, "<u2").reshape(valid.shape)[valid].astype(np.uint16)


CODEC = Codec(RawSettings, RawEncoder, RawDecoder)

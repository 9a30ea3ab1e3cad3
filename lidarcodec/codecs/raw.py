"""`raw`: every plane as it is, little endian, for readers that want nothing but a loop (docs/wire-format.md, "raw").

Ranges are always exact. It shows what the others save, and carries frames where bits cost nothing.
"""

from __future__ import annotations

import struct
from typing import Final

import numpy as np

from lidarcodec.codecs.base import Codec, CodecSettings, Decoder, Encoder, InForce
from lidarcodec.codecs.frame_decoder import SessionDecoder
from lidarcodec.codecs.frame_encoder import Coded, FrameEncoder
from lidarcodec.errors import SectionError
from lidarcodec.frame import Frame
from lidarcodec.message import Section, SectionType
from lidarcodec.planes.intensity import Quality, reduced
from lidarcodec.planes.sections import check_unfired, fired_cells, pose_sections, position_sections
from lidarcodec.settings import StreamSettings
from lidarcodec.side import SideInfo
from lidarcodec.units import AZIMUTH_TURN, BLOCK_BYTES, BLOCKS_PER_PACKET, LASERS_PER_BLOCK

_SIDE_HEAD: Final = struct.Struct("<HII")


class RawSettings(CodecSettings):
    """`raw` has no settings of its own."""


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
            Section(SectionType.RANGE, np.where(valid, frame.range_u16, np.uint16(0)).astype("<u2").tobytes()),
            Section(SectionType.AZIMUTH, frame.azimuth.astype("<u2").tobytes() + halves.tobytes()),
        ]
        if quality.levels:
            intensity = frame.intensity
            if not quality.lossless:
                intensity = reduced(frame, quality)
            elif frame.keep is not None:
                intensity = np.where(valid, intensity, np.uint8(0))
            sections.append(Section(SectionType.INTENSITY, intensity.tobytes()))
        if (side := frame.blocks) is not None:
            sections.append(Section(SectionType.SIDE, _encode_side(side)))
        return Coded(sections + position_sections(frame) + pose_sections(frame), None)


def _encoder(codec_id: int, settings: StreamSettings, stream_id: int) -> Encoder:
    return FrameEncoder(codec_id, settings, stream_id, RawSettings, RawContent(), plain_calibration=True)


def _decoder(codec_id: int) -> Decoder:
    return SessionDecoder(codec_id, _decode_side)


CODEC = Codec(RawSettings, _encoder, _decoder)

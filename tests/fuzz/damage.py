"""Damage inside of messages, sealed again: every checksum and name that a message or a section carries is right.

What a decoder then sees is not a bad link but a bad neighbour: all that stands before the damage says that it is whole.
"""

from __future__ import annotations

import hashlib
import random
import re
import zlib
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from lidarcodec._native import crc32c
from lidarcodec.codecs import table
from lidarcodec.errors import LidarCodecError, SectionError
from lidarcodec.message import Message, Section, SectionType
from lidarcodec.network.shelf import weights_of
from lidarcodec.network.update import applied, is_update
from lidarcodec.planes.calibrations import encode_calibration
from lidarcodec.sensor_model import Calibration, SensorModel
from lidarcodec.units import MAX_COLUMNS, MAX_PACKETS
from lidarcodec.wire import pack
from lidarcodec.wire.header import MAX_FRAMES
from tests.fuzz.inside import damaged_lattice, damaged_positions
from tests.fuzz.inside_others import damaged_cloud, damaged_description, damaged_planes, damaged_rest
from tests.fuzz.mutations import wounded

CODECS = 11
_KIND_AT = {table.codec_id("riddle"): 11, table.codec_id("predictive"): 2}
"""Where ranges by contexts say of which kind they are: behind the step, and in `riddle` behind the networks."""
_PNG = b"\x89PNG\r\n\x1a\n"
_SAYS = re.compile(r"gives weights ([0-9a-f]{16}) and says")


def damaged(message: Message, others: Sequence[Section], rng: random.Random) -> bytes:
    """A message with damage in its sections, its header or both, whole and sealed. others: sections of its stream."""
    sections, fields = list(message.sections), {}
    if (kind := rng.random()) < 0.8:
        for _ in range(rng.choice((1, 1, 2))):
            _harm(sections, others, message, rng)
    if kind > 0.7:
        fields = _other_fields(message, rng)
    try:
        return pack(replace(message, sections=tuple(sections), **fields))
    except LidarCodecError:  # fields that no message can have
        return pack(replace(message, sections=tuple(sections)))


def _harm(sections: list[Section], others: Sequence[Section], message: Message, rng: random.Random) -> None:
    if not sections:
        return
    at = rng.randrange(len(sections))
    section = sections[at]
    match rng.randrange(16):
        case 0:
            del sections[at]
        case 1:
            sections.append(section)
        case 2:
            sections[at] = section._replace(
                type=rng.randrange(max(SectionType) + 2), ordinal=rng.choice((0, 0, 1, 7, 63, 255))
            )
        case 3:
            sections[at] = section._replace(data=rng.choice(others).data)
        case 4:
            sections.append(rng.choice(others))
        case _:
            sections[at] = section._replace(data=_sealed(section, sections, message, rng))


def _sealed(section: Section, sections: list[Section], message: Message, rng: random.Random) -> bytes:
    """A section's bytes, damaged, with the checksums and names that they carry made right; now and then not all."""
    codec = message.codec
    if message.planes and rng.random() < 0.6:
        match section.type:
            case SectionType.CALIBRATION:
                return damaged_description(section.data, rng)
            case SectionType.PLANES:
                return damaged_planes(section.data, rng)
            case SectionType.REST:
                return damaged_rest(section.data, message.packets, rng)
            case SectionType.CLOUD:
                return damaged_cloud(section.data, rng)
    if section.type == SectionType.CALIBRATION and rng.random() < 0.3:
        return encode_calibration(_wild_sensor(rng), key=True, plain=rng.random() < 0.5)
    if section.type == SectionType.LATTICE and rng.random() < 0.7:
        return damaged_lattice(section.data, rng)
    if section.type == SectionType.POSITION and rng.random() < 0.7:
        return damaged_positions(section.data, rng)
    if section.type == SectionType.RANGE and codec in _KIND_AT and rng.random() < 0.3:
        return _of_another_kind(section.data, _KIND_AT[codec], rng)
    data = wounded(section.data, rng)
    if section.type == SectionType.WEIGHTS and rng.random() < 0.9:
        return _with_names(data, sections, rng)
    if section.type == SectionType.RANGE and (begins := section.data[:16].find(_PNG)) >= 0:
        return data[:begins] + _with_png_checksums(data[begins:])
    return data


def _of_another_kind(data: bytes, at: int, rng: random.Random) -> bytes:
    """Ranges by contexts that say that they are free and are not, or the other way round, of another step, or both."""
    if len(data) <= at:
        return wounded(data, rng)
    out = bytearray(data)
    if (both := rng.random()) < 0.7:
        kind = out[at]
        out[at] = (kind + rng.choice((4, -4, 4, -4, 64, -64, 1, -1, 6, -6))) & 255
    if both > 0.5:
        out[:2] = rng.choice((0, 1, 2, 3, 5, 7, 51, 4999, 65533, 65535, rng.randrange(65536))).to_bytes(2, "little")
    return bytes(out) if rng.random() < 0.7 else wounded(bytes(out), rng)


def _wild_sensor(rng: random.Random) -> SensorModel:
    """A sensor of any numbers at all."""
    numbers = np.random.default_rng(rng.randrange(1 << 32))
    most = rng.choice((1 << 31, 1 << 24, 10))
    table = numbers.integers(-most, most, (11, 64)).astype(np.int32)
    name = rng.choice(("", "HDL-64E", "é" * 100, "\0"))
    return SensorModel(
        name, Calibration(table), "given", rng.choice(("ros", "veloview")), rng.choice((1e-7, 0.002, 400.0))
    )


def _with_checksum(data: bytes) -> bytes:
    return data[:-4] + int(crc32c(data[:-4])).to_bytes(4, "little") if len(data) > 4 else data


def _with_names(data: bytes, sections: list[Section], rng: random.Random) -> bytes:
    """Weights with their checksum; half of them also with names that agree, so that ranges are read with them."""
    data = _with_checksum(data)
    if rng.random() < 0.5:
        return data
    if is_update(data):
        try:
            applied(data, _of_package)
        except SectionError as error:
            if (said := _SAYS.search(str(error))) is not None:
                data = _with_checksum(data[:13] + bytes.fromhex(said[1]) + data[21:])
        except LidarCodecError:
            return data
        name = data[13:21]
    else:
        name = hashlib.sha256(data).digest()[:8]
    for at, section in enumerate(sections):
        if section.type == SectionType.RANGE and len(section.data) > 11:
            sections[at] = section._replace(data=section.data[:3] + name + section.data[11:])
    return data


@cache
def _package_weights() -> Any:
    return weights_of("")


def _of_package(name: str) -> Any:
    """The weights of the package, whatever name is asked for: the fuzzer's updates begin with them."""
    return _package_weights()


def _with_png_checksums(data: bytes) -> bytes:
    """A PNG whose parts have right checksums, as far as it has parts."""
    out, at = bytearray(data), 8
    while at + 12 <= len(out):
        ends = at + 8 + int.from_bytes(out[at : at + 4], "big")
        if ends + 4 > len(out):
            break
        out[ends : ends + 4] = zlib.crc32(out[at + 4 : ends]).to_bytes(4, "big")
        at = ends + 4
    return bytes(out)


def _other_fields(message: Message, rng: random.Random) -> dict[str, Any]:
    """One field of the header that does not fit the rest."""
    width, packets = message.width, message.packets
    match rng.randrange(8):
        case 0:
            widths = (0, 1, 5, 6, width - 1, width + 1, width * 2, MAX_COLUMNS, rng.randrange(MAX_COLUMNS + 1))
            return {"width": min(max(rng.choice(widths), 0), MAX_COLUMNS)}
        case 1:
            counts = (0, 1, packets - 1, packets + 1, MAX_PACKETS, rng.randrange(MAX_PACKETS + 1))
            return {"packets": min(max(rng.choice(counts), 0), MAX_PACKETS)}
        case 2:
            return {"codec": rng.randrange(1, CODECS + 1)}
        case 3:
            return {"frame_count": rng.choice((1, 2, 8, MAX_FRAMES, rng.randrange(1, MAX_FRAMES + 1)))}
        case 4:
            return {"key": not message.key, "needs": None}
        case 5:
            needs = rng.choice((None, 0, max(0, message.frame_index - 1)))
            return {"key": False, "needs": needs} if message.frame_index else {"key": False}
        case 6:
            return {"width": MAX_COLUMNS, "packets": rng.choice((0, MAX_PACKETS))}
        case _:
            return {
                "frame_index": rng.choice((0, message.frame_index + 1, 2**63 - 1)),
                "stamp_ns": rng.choice((-(2**63), 2**63 - 1)),
                "needs": None,
            }

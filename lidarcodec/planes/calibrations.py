"""The CALIBRATION section: the whole table in key messages, its 8-byte hash in all others.

Layout (docs/wire-format.md): form u8, hash 8 bytes; in forms 1 and 2 then convention u8, range step u32 (0.1 um), name
length u8, name in UTF-8, and the table of 11 x 64 int32, little endian: one zstd frame in form 1, as it is in form 2.
"""

from __future__ import annotations

import struct
from collections import OrderedDict
from functools import lru_cache
from typing import Final, get_args

import numpy as np

from lidarcodec.entropy.zstd_frames import compress, decompress
from lidarcodec.errors import MissingReferenceError, SectionError
from lidarcodec.message import Message, SectionType
from lidarcodec.sensor_model import CALIBRATION_FIELDS, Calibration, Convention, SensorModel
from lidarcodec.units import LASERS

FORM_HASH: Final = 0
FORM_TABLE: Final = 1
FORM_PLAIN_TABLE: Final = 2
CONVENTIONS: Final[tuple[Convention, ...]] = get_args(Convention)
_HASH_BYTES: Final = 8
_TABLE_HEAD: Final = struct.Struct("<BIB")
_STEPS_PER_METRE: Final = 10_000_000
_TABLE_BYTES: Final = len(CALIBRATION_FIELDS) * LASERS * 4
_KEPT: Final = 8
"""Most calibrations that a decoder remembers. A normal stream has one; a hostile stream must not fill memory."""


@lru_cache(maxsize=_KEPT)
def _table_form(sensor: SensorModel, plain: bool) -> bytes:
    name = sensor.name.encode()
    step = round(sensor.range_step_m * _STEPS_PER_METRE)
    if len(name) > 0xFF or not 0 < step <= 0xFFFFFFFF:
        raise SectionError(f"sensor name '{sensor.name}' or range step {sensor.range_step_m} m does not fit a message")
    head = _TABLE_HEAD.pack(CONVENTIONS.index(sensor.convention), step, len(name))
    table = sensor.calibration.table.astype("<i4").tobytes()
    form = FORM_PLAIN_TABLE if plain else FORM_TABLE
    return bytes([form]) + bytes.fromhex(sensor.hash) + head + name + (table if plain else compress(table, 19))


def encode_calibration(sensor: SensorModel, key: bool, plain: bool = False) -> bytes:
    """Bytes of the section: the table for a key message, uncompressed when `plain`; else the hash."""
    return _table_form(sensor, plain) if key else bytes([FORM_HASH]) + bytes.fromhex(sensor.hash)


def _read_table(data: bytes) -> SensorModel:
    at = 1 + _HASH_BYTES
    if len(data) < at + _TABLE_HEAD.size:
        raise SectionError(f"a calibration section of {len(data)} bytes ends within its head")
    convention, step, name_bytes = _TABLE_HEAD.unpack_from(data, at)
    at += _TABLE_HEAD.size
    if convention >= len(CONVENTIONS) or not step:
        raise SectionError(f"calibration of unknown convention {convention} or range step {step}")
    try:
        name = data[at : at + name_bytes].decode()
    except UnicodeDecodeError:
        raise SectionError("a sensor name that is not UTF-8") from None
    table = data[at + name_bytes :]
    if data[0] == FORM_TABLE:
        table = decompress(table, _TABLE_BYTES)
    if len(table) != _TABLE_BYTES:
        raise SectionError(f"a calibration table of {len(table)} bytes, not {_TABLE_BYTES}")
    calibration = Calibration(np.frombuffer(table, "<i4").astype(np.int32).reshape(len(CALIBRATION_FIELDS), LASERS))
    sensor = SensorModel(name, calibration, "message", CONVENTIONS[convention], step / _STEPS_PER_METRE)
    if sensor.hash != data[1 : 1 + _HASH_BYTES].hex():
        raise SectionError(f"a calibration with hash {sensor.hash} that calls itself {data[1:9].hex()}")
    return sensor


class SensorBook:
    """Sensors that the key messages of a stream described, by hash; the last eight are kept."""

    def __init__(self) -> None:
        self._known: OrderedDict[str, tuple[bytes, SensorModel]] = OrderedDict()

    def sensor_of(self, message: Message) -> SensorModel:
        """The sensor of a message.

        Raises MissingReferenceError if the message has only the hash of an unknown calibration, SectionError.
        """
        data = message.section(SectionType.CALIBRATION)
        if len(data) < 1 + _HASH_BYTES or data[0] > FORM_PLAIN_TABLE:
            raise SectionError(f"a calibration section of {len(data)} bytes, form {data[:1].hex() or 'missing'}")
        name = data[1 : 1 + _HASH_BYTES].hex()
        known = self._known.get(name)
        if data[0] == FORM_HASH:
            if len(data) != 1 + _HASH_BYTES:
                raise SectionError(f"{len(data)} bytes for a calibration's hash")
            if known is None:
                raise MissingReferenceError(
                    f"frame {message.frame_index} needs calibration {name}, which no key frame has brought yet: "
                    "ask for a key frame",
                    message.frame_index,
                )
            self._known.move_to_end(name)
            return known[1]
        if known is None or known[0] != data:
            known = (data, _read_table(data))
            self._known[name] = known
            while len(self._known) > _KEPT:
                self._known.popitem(last=False)
        self._known.move_to_end(name)
        return known[1]

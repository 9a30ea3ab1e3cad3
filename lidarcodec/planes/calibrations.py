"""The CALIBRATION section: the whole table in key messages, its 8-byte hash in all others.

Layout (docs/wire-format.md): form u8, hash 8 bytes; in forms 1 and 2 then convention u8, range step u32 (0.1 um), name
length u8, name in UTF-8, and the table of 11 x 64 int32, little endian: one zstd frame in form 1, as it is in form 2.
"""

from __future__ import annotations

import struct
from functools import lru_cache
from typing import Final, get_args

import numpy as np

from lidarcodec.entropy.zstd_frames import compress
from lidarcodec.errors import SectionError, TruncatedError
from lidarcodec.planes.other_calibrations import FORM_OTHER, Described, described_in, other_form
from lidarcodec.sensor_model import CALIBRATION_FIELDS, HDL64E, Calibration, Convention, SensorModel
from lidarcodec.units import LASERS

FORM_HASH: Final = 0
FORM_TABLE: Final = 1
FORM_PLAIN_TABLE: Final = 2
CONVENTIONS: Final[tuple[Convention, ...]] = get_args(Convention)
_TABLE_HEAD: Final = struct.Struct("<BIB")
_STEPS_PER_METRE: Final = 10_000_000
_HASH_BYTES: Final = 8
_KEPT: Final = 8
"""Most calibrations that are remembered. A normal stream has one; a hostile stream must not fill memory."""


@lru_cache(maxsize=_KEPT)
def _table_form(sensor: SensorModel, plain: bool) -> bytes:
    if not sensor.is_hdl64e:
        return other_form(sensor)
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


def peek_sensor(section: bytes) -> Described | None:
    """Name, model, rows and range step of the sensor of a message, by its section; None if that has the hash alone.

    Raises SectionError, TruncatedError.
    """
    form, rest = section[:1], section[1 + _HASH_BYTES :]
    if form == bytes([FORM_OTHER]):
        return described_in(rest)
    if form not in (bytes([FORM_TABLE]), bytes([FORM_PLAIN_TABLE])):
        return None
    if len(rest) < _TABLE_HEAD.size:
        raise TruncatedError(f"a calibration section of {len(section)} bytes")
    _, step, length = _TABLE_HEAD.unpack_from(rest)
    name = rest[_TABLE_HEAD.size : _TABLE_HEAD.size + length]
    return Described(name.decode("utf-8", "replace"), HDL64E, LASERS, step / _STEPS_PER_METRE)


@lru_cache(maxsize=_KEPT)
def sensor_of(name: str, convention: int, range_step: int, table: bytes) -> SensorModel:
    """The sensor that a message describes, as the native core reads its section.

    convention: its number in CONVENTIONS; range_step: in 1e-7 m; table: (11, 64) int32 in the machine's byte order
    """
    values = np.frombuffer(table, np.int32).reshape(len(CALIBRATION_FIELDS), LASERS)
    return SensorModel(name, Calibration(values), "message", CONVENTIONS[convention], range_step / _STEPS_PER_METRE)

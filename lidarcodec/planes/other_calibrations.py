"""Form 3 of the CALIBRATION section: of other sensors than an HDL-64E. It has the model, the number of rows, the
sensor's own description and the calibration table, in key messages; others have the hash alone (form 0).
"""

from __future__ import annotations

import struct
from functools import lru_cache
from typing import Final, NamedTuple, get_args

import numpy as np

from lidarcodec.entropy.zstd_frames import compress, decompress
from lidarcodec.errors import SectionError
from lidarcodec.sensor_model import (
    CALIBRATION_FIELDS,
    Calibration,
    Convention,
    SensorModel,
)
from lidarcodec.units import RANGE_STEP_M

FORM_OTHER: Final = 3
MAX_DESCRIPTION: Final = 1 << 20
"""Most bytes of a sensor's description of itself."""
MAX_PLAIN: Final = MAX_DESCRIPTION + (1 << 14)
"""Most bytes of the section's contents: a description, names and the table; the native core has the same limit."""
_CONVENTIONS: Final[tuple[Convention, ...]] = get_args(Convention)
_HEAD: Final = struct.Struct("<BIBBBI")
_STEPS_PER_METRE: Final = 10_000_000
_KEPT: Final = 8
"""Most sensors that are remembered. A normal stream has one; a hostile stream must not fill memory."""


def other_form(sensor: SensorModel) -> bytes:
    """Bytes of the section in key messages.

    Raises SectionError if name, model, description or range step do not fit.
    """
    name, step = sensor.name.encode(), round(sensor.range_step_m * _STEPS_PER_METRE)
    if len(name) > 0xFF or not 0 < step <= 0xFFFFFFFF:
        raise SectionError(f"sensor name '{sensor.name}' or range step {sensor.range_step_m} m does not fit a message")
    model, description = sensor.model.encode(), sensor.description
    if len(model) > 0xFF or len(description) > MAX_DESCRIPTION:
        raise SectionError(f"a sensor's description of {len(description)} bytes: the limit is {MAX_DESCRIPTION}")
    convention = _CONVENTIONS.index(sensor.convention)
    head = _HEAD.pack(convention, step, len(name), len(model), sensor.rows, len(description))
    plain = head + name + model + description + sensor.calibration.table.astype("<i4").tobytes()
    size = len(plain).to_bytes(4, "little")
    return bytes([FORM_OTHER]) + bytes.fromhex(sensor.hash) + size + compress(plain, 19)


class Described(NamedTuple):
    """What a section says of its sensor: title, name of the model as in `--model`, number of rows, metres of a range
    unit."""

    name: str
    model: str
    rows: int
    range_step_m: float = RANGE_STEP_M


def described_in(data: bytes) -> Described:
    """What the section says, from the size on. The table is not read.

    Raises SectionError.
    """
    size = int.from_bytes(data[:4], "little")
    if not _HEAD.size <= size <= MAX_PLAIN:
        raise SectionError(f"a description of a sensor of {size} bytes")
    plain = decompress(data[4:], size)
    _, step, length, model_length, rows, _ = _HEAD.unpack_from(plain)
    name, model = plain[_HEAD.size :][:length], plain[_HEAD.size + length :][:model_length]
    return Described(name.decode("utf-8", "replace"), model.decode("ascii", "replace"), rows, step / _STEPS_PER_METRE)


@lru_cache(maxsize=_KEPT)
def described_sensor(
    name: str, convention: int, range_step: int, rows: int, model: str, description: bytes, table: bytes
) -> SensorModel:
    """The sensor that a message describes, as the native core reads its section.

    convention: its place in the list of conventions; range_step: in 1e-7 m; table: (11, `rows`) int32 in the machine's
    byte order
    """
    calibration = Calibration(np.frombuffer(table, np.int32).reshape(len(CALIBRATION_FIELDS), rows))
    step_m = range_step / _STEPS_PER_METRE
    return SensorModel(name, calibration, "message", _CONVENTIONS[convention], step_m, model, description)

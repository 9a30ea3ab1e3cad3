"""Form 3 of the CALIBRATION section: of other sensors than an HDL-64E. It has the model, the number of rows, the
sensor's own description and the calibration table, in key messages; others have the hash alone (form 0).
"""

from __future__ import annotations

import struct
from collections import OrderedDict
from typing import Final, get_args

import numpy as np

from lidarcodec.entropy.zstd_frames import compress, decompress
from lidarcodec.errors import CalibrationError, MissingReferenceError, SectionError
from lidarcodec.message import Message, SectionType
from lidarcodec.sensor_model import (
    CALIBRATION_FIELDS,
    HDL64E,
    MAX_LASERS,
    Calibration,
    Convention,
    SensorModel,
)
from lidarcodec.sensors.models.table import is_known, sensor_of

FORM_HASH: Final = 0
FORM_OTHER: Final = 3
MAX_DESCRIPTION: Final = 1 << 20
"""Most bytes of a sensor's description of itself."""
_CONVENTIONS: Final[tuple[Convention, ...]] = get_args(Convention)
_HASH_BYTES: Final = 8
_HEAD: Final = struct.Struct("<BIBBBI")
_STEPS_PER_METRE: Final = 10_000_000
_MOST: Final = MAX_DESCRIPTION + (1 << 14)
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


def _read_other(data: bytes) -> SensorModel:
    at = 1 + _HASH_BYTES
    size = int.from_bytes(data[at : at + 4], "little")
    if len(data) < at + 4 or not _HEAD.size <= size <= _MOST:
        raise SectionError(f"a calibration section of {len(data)} bytes that announces {size}")
    plain = decompress(data[at + 4 :], size)
    convention, step, name_bytes, model_bytes, rows, description_bytes = _HEAD.unpack_from(plain)
    if convention >= len(_CONVENTIONS) or not step or not 1 <= rows <= MAX_LASERS:
        raise SectionError(f"calibration of unknown convention {convention}, range step {step} or {rows} rows")
    table_bytes = len(CALIBRATION_FIELDS) * rows * 4
    if size != _HEAD.size + name_bytes + model_bytes + description_bytes + table_bytes:
        raise SectionError(f"a calibration of {size} bytes whose parts do not add up")
    at = _HEAD.size
    try:
        name = plain[at : (at := at + name_bytes)].decode()
        model = plain[at : (at := at + model_bytes)].decode("ascii")
    except UnicodeDecodeError:
        raise SectionError("a sensor name that is not UTF-8, or a model that is not ASCII") from None
    description = plain[at : at + description_bytes]
    table = np.frombuffer(plain[at + description_bytes :], "<i4").astype(np.int32)
    if model == HDL64E or not is_known(model):
        raise SectionError(f"a sensor of model '{model[:40]}', which this build does not know: update it")
    calibration = Calibration(table.reshape(len(CALIBRATION_FIELDS), rows))
    step_m = step / _STEPS_PER_METRE
    sensor = SensorModel(name, calibration, "message", _CONVENTIONS[convention], step_m, model, description)
    try:
        sensor_of(sensor)
    except CalibrationError as error:
        raise SectionError(f"a sensor whose description cannot be used: {error}") from None
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
        if len(data) < 1 + _HASH_BYTES or data[0] not in (FORM_HASH, FORM_OTHER):
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
            known = (data, _read_other(data))
            if known[1].hash != name:
                raise SectionError(f"a calibration with hash {known[1].hash} that calls itself {name}")
            self._known[name] = known
            while len(self._known) > _KEPT:
                self._known.popitem(last=False)
        self._known.move_to_end(name)
        return known[1]

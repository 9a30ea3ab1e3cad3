"""The warning that a source's sensor is decoded with a generic calibration, said once for each source."""

from __future__ import annotations

import logging
from functools import cache
from typing import Final

from lidarcodec.sensor_model import SensorModel
from lidarcodec.sensors.generic import TABLES, generic_sensor
from lidarcodec.sources.base import REGRIDDED

logger = logging.getLogger(__name__)

MEANING: Final = "clouds can be wrong by up to about half a metre; packets and ranges are not affected"
REMEDY: Final = "give --calibration FILE, or put NAME_db.xml beside the capture"
LIVE_REMEDY: Final = "give --calibration FILE, or wait for the sensor's own table"
MAX_SAID: Final = 256

_said: set[str] = set()


@cache
def generic_hashes() -> frozenset[str]:
    """Hashes of the generic tables: a recording of such a sensor is known by them."""
    return frozenset(generic_sensor(model).hash for model in TABLES)


def is_generic(sensor: SensorModel) -> bool:
    """Whether the calibration is not that of the unit; a scan that was put into a grid has none to miss."""
    generic = sensor.origin == "generic" or (sensor.origin != "given" and sensor.hash in generic_hashes())
    return generic and REGRIDDED not in sensor.name


def note_of(sensor: SensorModel) -> str | None:
    """What a viewer of its clouds has to know about a sensor's calibration; None: nothing."""
    if sensor.origin == "simulated" or not is_generic(sensor):
        return None
    return f"generic calibration: {MEANING}"


def warn_if_generic(sensor: SensorModel, label: str, *, live: bool = False) -> bool:
    """Say what a generic calibration means, once for each source; whether it is one."""
    if note_of(sensor) is None:
        return False
    if label not in _said:
        if len(_said) >= MAX_SAID:
            _said.clear()
        _said.add(label)
        remedy = LIVE_REMEDY if live else REMEDY
        logger.warning(
            "%s: this unit has no calibration of its own, so a generic one is used: %s; %s", label, MEANING, remedy
        )
    return True

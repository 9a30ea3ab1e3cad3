"""The warning about a generic calibration, logged once for each source."""

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
    """Hashes of the generic tables, to recognise them in recordings."""
    return frozenset(generic_sensor(model).hash for model in TABLES)


def is_generic(sensor: SensorModel) -> bool:
    """Whether the calibration is a generic one. Re-gridded scans never count: they need no calibration of a unit."""
    generic = sensor.origin == "generic" or (sensor.origin != "given" and sensor.hash in generic_hashes())
    return generic and REGRIDDED not in sensor.name


def note_of(sensor: SensorModel) -> str | None:
    """A note about a generic calibration for viewers of clouds; None without one."""
    if sensor.origin == "simulated" or not is_generic(sensor):
        return None
    return f"generic calibration: {MEANING}"


def warn_if_generic(sensor: SensorModel, label: str, *, live: bool = False) -> bool:
    """Log what a generic calibration means, once for each source; returns whether the calibration is generic."""
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

"""The sensor that a UDP source assumes until its packets tell."""

from __future__ import annotations

from pathlib import Path

from lidarcodec.errors import CalibrationError
from lidarcodec.sensor_model import HDL64E, SensorModel
from lidarcodec.sensors import find_calibration, find_sensor
from lidarcodec.sensors.models.table import PACKETS


def sensor_before_packets(calibration: Path | None, model: str | None) -> SensorModel | None:
    """The sensor that is assumed before its packets are seen; None if it can be no HDL-64E.

    Raises CalibrationError, UnknownNameError.
    """
    if model == PACKETS:
        return find_sensor(None, None, (), model)
    if model not in (None, HDL64E):
        return None
    try:
        return find_calibration(None, calibration, ())
    except CalibrationError:
        if model == HDL64E or calibration is None or not calibration.is_file():
            raise
        return None

"""What lies beside a capture, so that its points are right: a calibration, or the metadata of an Ouster."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from lidarcodec.budgets import FileTooLargeError, read_file
from lidarcodec.commands.capture_records import named_beside
from lidarcodec.errors import CalibrationError, SettingsError
from lidarcodec.files.whole import Whole
from lidarcodec.sensor_model import SensorModel
from lidarcodec.sensors import read_calibration
from lidarcodec.sensors.models.table import sensor_named
from lidarcodec.sources.described import description_of


def check_beside(out: Path, sensor: SensorModel, *, force: bool) -> tuple[str, bytes] | None:
    """What is to be written beside a capture; None for nothing, or if it is there.

    Raises SettingsError if another calibration is there.
    """
    found = description_of(sensor)
    if found is None:
        return None
    path = named_beside(out, found[0])
    if not path.exists():
        return found
    if _is_of(path, found[1], sensor):
        return None
    if not force:
        what = "is not the metadata of this sensor" if sensor.description else "holds another calibration"
        raise SettingsError(f"{path} exists and {what}: use --force to replace it", "force")
    return found


def write_beside(output: Whole, found: tuple[str, bytes]) -> None:
    """Write it; it gets its name together with the output."""
    ending, data = found
    output.companion(partial(named_beside, ending=ending), Path(ending).suffix or ending).write_bytes(data)


def _is_of(path: Path, data: bytes, sensor: SensorModel) -> bool:
    try:
        there = read_file(path, "calibration")
        if there == data or sensor.description:
            return there == data
        if sensor.is_hdl64e:
            return read_calibration(path, "beside").hash == sensor.hash
        return sensor_named(sensor.model).calibrated(there, "beside", str(path)).hash == sensor.hash
    except (OSError, FileTooLargeError, CalibrationError):
        return False

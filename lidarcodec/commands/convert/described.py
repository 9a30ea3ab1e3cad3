"""What lies beside a capture, so that its points are right: a calibration, or the metadata of an Ouster."""

from __future__ import annotations

import os
from functools import partial
from pathlib import Path

from lidarcodec.budgets import FileTooLargeError, read_file
from lidarcodec.commands.capture_records import named_beside
from lidarcodec.errors import CalibrationError, SettingsError
from lidarcodec.files.whole import Whole, check_free
from lidarcodec.sensor_model import SensorModel
from lidarcodec.sensors import STATUS_PACKETS, read_calibration
from lidarcodec.sensors.models.table import sensor_named
from lidarcodec.sources.described import description_of


def check_beside(
    out: Path, sensor: SensorModel, *, force: bool, source: Path | None = None
) -> tuple[str, bytes] | None:
    """What is to be written beside a capture, or into a folder; None for nothing, or if it is there.

    source: what is read; a file beside that is never replaced
    Raises SettingsError if another calibration is there.
    """
    found = description_of(sensor)
    if found is None or not out.suffix:
        return found
    path = named_beside(out, found[0])
    if not os.path.lexists(path):
        check_free(path)
        return found
    if _is_of(path, found[1], sensor):
        return None
    what = "is not the metadata of this sensor" if sensor.description else "holds another calibration"
    if not force:
        raise SettingsError(f"{path} exists and {what}: use --force to replace it", "force")
    own = None if source is None else named_beside(source, found[0])
    if own is not None and own.exists() and path.samefile(own):
        raise SettingsError(f"{path} is the calibration of the source: give the output another name", "force")
    return found


def needs_file(sensor: SensorModel, packets: int) -> bool:
    """Whether so many packets of a sensor do not hold its whole table themselves."""
    return sensor.origin != "stream" or packets < STATUS_PACKETS


def write_beside(output: Whole, found: tuple[str, bytes]) -> None:
    """Write it; it gets its name together with the output."""
    ending, data = found
    if output.path.suffix:
        place = output.companion(partial(named_beside, ending=ending), Path(ending).suffix or ending)
    else:
        place = output.beside / ending.lstrip("_")
    place.write_bytes(data)


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

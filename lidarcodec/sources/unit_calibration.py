"""The warning about a generic calibration, logged once for each source."""

from __future__ import annotations

import logging
from functools import cache
from pathlib import Path
from typing import Final, NamedTuple

from lidarcodec.sensor_model import HDL64E, POINTCLOUD2, SensorModel
from lidarcodec.sensors.capture_names import stem_of
from lidarcodec.sensors.generic import TABLES, generic_sensor
from lidarcodec.sensors.models.ouster.sensor import METADATA_URL, bare_sensors
from lidarcodec.sensors.models.table import OUSTERS, PACKETS, names, sensor_named
from lidarcodec.sources.base import REGRIDDED

logger = logging.getLogger(__name__)

MEANING: Final = "clouds can be wrong by up to about half a metre; packets and ranges are not affected"
REMEDY: Final = "give --calibration FILE, or put {name}_db.xml beside {file}"
LIVE_REMEDY: Final = "give --calibration FILE, or wait for the sensor's own table"
OTHER_MEANING: Final = "beams can be a few tenths of a degree off; packets and ranges are not affected"
OTHER_REMEDY: Final = "give --calibration FILE, or put {name}.csv beside {file}"
NO_METADATA: Final = "there are no points; packets and images are not affected"
METADATA_REMEDY: Final = f"save {METADATA_URL} as {{name}}.json beside {{file}}, or give it with --calibration"
MAX_SAID: Final = 256

_WITHOUT: Final = (HDL64E, POINTCLOUD2, PACKETS, *OUSTERS)
"""Models that have no generic calibration of their own here."""
_said: set[str] = set()


@cache
def generic_hashes() -> frozenset[str]:
    """Hashes of the generic tables, to recognise them in recordings."""
    hdl64e = {generic_sensor(model).hash for model in TABLES}
    named = {sensor_named(model).generic_sensor.hash for model in names() if model not in _WITHOUT}
    return frozenset(hdl64e | named | {sensor.generic_sensor.hash for sensor in bare_sensors().values()})


def is_generic(sensor: SensorModel) -> bool:
    """Whether the calibration is a generic one. Re-gridded scans never count: they need no calibration of a unit."""
    generic = sensor.origin == "generic" or (sensor.origin != "given" and sensor.hash in generic_hashes())
    return generic and REGRIDDED not in sensor.name


class _Note(NamedTuple):
    """What is not as it should be, what that means, and what to do."""

    what: str
    meaning: str
    remedy: str
    in_short: str = "generic calibration"


def _note(sensor: SensorModel, *, live: bool = False) -> _Note | None:
    if sensor.origin == "simulated" or sensor.model in (PACKETS, POINTCLOUD2) or not is_generic(sensor):
        return None
    missing = "this unit has no calibration of its own, so a generic one is used"
    if sensor.is_hdl64e:
        return _Note(missing, MEANING, LIVE_REMEDY if live else REMEDY)
    if sensor.model in bare_sensors():
        return _Note("the metadata of this Ouster is missing", NO_METADATA, METADATA_REMEDY, "no metadata")
    return _Note(missing, OTHER_MEANING, OTHER_REMEDY) if sensor_named(sensor.model).per_unit else None


def note_of(sensor: SensorModel) -> str | None:
    """A note for viewers of clouds about a generic calibration, or missing metadata; None without one."""
    note = _note(sensor)
    return None if note is None else f"{note.in_short}: {note.meaning}"


def remark_on(sensor: SensorModel, path: Path | None = None, *, live: bool = False) -> str:
    """What a generic calibration, or missing metadata, means, and what to do; empty without one.

    path: of the capture, beside which a calibration may lie
    """
    note = _note(sensor, live=live)
    if note is None:
        return ""
    name, file = ("NAME", "NAME.pcap") if path is None else (stem_of(path), path.name)
    return f"{note.what}: {note.meaning}; {note.remedy.format(name=name, file=file)}"


def warn_if_generic(sensor: SensorModel, label: str, path: Path | None = None, *, live: bool = False) -> bool:
    """Log what a generic calibration, or missing metadata, means, once for each source; returns whether it is so.

    path: of the capture, beside which a calibration may lie
    """
    remark = remark_on(sensor, path, live=live)
    if remark and label not in _said:
        if len(_said) >= MAX_SAID:
            _said.clear()
        _said.add(label)
        logger.warning("%s: %s", label, remark)
    return bool(remark)

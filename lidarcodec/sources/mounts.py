"""Mountings of a vehicle's sensors: a text of six numbers, or a file with all of them, YAML or JSON.

roof: [1.5, 0, 1.8, 0, 0, 90]       # X, Y, Z in metres; ROLL, PITCH, YAW in degrees
front: {x_m: 3.2, z_m: 0.6, pitch_deg: 5}
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

from lidarcodec.budgets import FileTooLargeError, read_file
from lidarcodec.errors import SettingsError
from lidarcodec.mounting import NAMES, Mounting
from lidarcodec.settings import is_name
from lidarcodec.sources.base import PacketSource
from lidarcodec.untrusted.yaml import YamlRefusedError, read_yaml

MOST_SENSORS: Final = 64
SENSOR, VEHICLE = "sensor", "vehicle"


@dataclass(frozen=True)
class Mounted:
    """What is known of where a sensor sits. of_vehicle: whether the file of poses has those of the vehicle"""

    mount: Mounting | None = None
    of_vehicle: bool = False

    @classmethod
    def of(cls, mount: str | None, poses_of: str | None, *, poses: bool, sensor: str | None = None) -> Mounted:
        """From the texts of `--mount` and `--poses-of`. poses: whether there is a file of poses;  sensor: as of
        `mount_of`

        Raises SettingsError.
        """
        if poses_of not in (None, SENSOR, VEHICLE):
            raise SettingsError(f"--poses-of {poses_of}: write {SENSOR} or {VEHICLE}", "poses_of")
        if poses_of == VEHICLE and not poses:
            raise SettingsError("--poses-of vehicle needs the poses: give --poses FILE", "poses_of")
        if poses_of == VEHICLE and mount is None:
            raise SettingsError(
                "--poses-of vehicle needs the place of the sensor on the vehicle: give --mount", "poses_of"
            )
        return cls(None if mount is None else mount_of(mount, sensor), poses_of == VEHICLE)

    def given_to(self, source: PacketSource) -> None:
        """Give a source its mounting, and turn poses of the vehicle into those of the sensor."""
        if self.mount is not None:
            source.mount = self.mount
            if self.of_vehicle and source.poses is not None:
                source.poses = source.poses.seen_from(self.mount.T_vehicle_sensor)


NOT_SAID: Final = Mounted()


def mount_of(text: str, sensor: str | None = None) -> Mounting:
    """The mounting that a text says: six numbers, or `FILE`, or `FILE#SENSOR`.

    sensor: the name of the sensor in the file, if the text has none; a file with a single sensor needs no name
    Raises SettingsError.
    """
    if text.count(",") == len(NAMES) - 1:
        return Mounting.parse(text)
    name, _, chosen = text.rpartition("#") if "#" in text else (text, "", "")
    path = Path(name)
    found = read_mounts(path)
    wanted = chosen or sensor
    if wanted is None and len(found) == 1:
        return next(iter(found.values()))
    if wanted is None:
        raise SettingsError(f"{path} has {len(found)} sensors: choose one, as in {path}#{next(iter(found))}", "mount")
    if wanted not in found:
        raise SettingsError(f"{path} has no sensor '{wanted}': choose one of {', '.join(found)}", "mount")
    return found[wanted]


def read_mounts(path: Path) -> dict[str, Mounting]:
    """The mountings in a file by the sensor's name: at least 1, at most 64.

    Raises SettingsError with the name of the sensor.
    """
    try:
        values = read_yaml(read_file(path, "config"))
    except OSError as error:
        missing = isinstance(error, FileNotFoundError)
        hint = "" if not missing else "; a mounting is a file, or X,Y,Z,ROLL,PITCH,YAW in metres and degrees"
        raise SettingsError(f"cannot read mountings from {path}: {error.strerror or error}{hint}", "mount") from None
    except (FileTooLargeError, YamlRefusedError) as error:
        raise SettingsError(f"cannot read mountings from {path}: {error}", "mount") from None
    if not isinstance(values, dict) or not 1 <= len(values) <= MOST_SENSORS:
        raise SettingsError(f"{path} must have 1 to {MOST_SENSORS} lines like `roof: [1.5, 0, 1.8, 0, 0, 90]`", "mount")
    found = {}
    for name, value in values.items():
        if not isinstance(name, str) or not is_name(name):
            raise SettingsError(f"{path}: {str(name)[:40]!r} is not a sensor's name", "mount")
        try:
            found[name] = Mounting.of_values(value)
        except SettingsError as error:
            raise SettingsError(f"{path}: {name}: {error}", "mount") from None
    return found

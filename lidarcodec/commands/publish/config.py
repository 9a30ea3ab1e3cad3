"""`lidarcodec publish --config FILE`: several sensors of one vehicle, described in a YAML file.

>>> text = "vehicle: car-7\\nsensors:\\n  - {name: roof, source: 'udp://:2368', settings: {max_error_m: -1}}"
>>> parse(text, "fleet.yaml")
Traceback (most recent call last):
lidarcodec.errors.SettingsError: fleet.yaml: sensors.0.settings: max_error_m must be at least 0
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Final, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from lidarcodec.apps.health import health_file_or_nothing
from lidarcodec.apps.notify import told_ready
from lidarcodec.apps.past.conditions import conditions_of
from lidarcodec.apps.past.keeper import Keep, bytes_of
from lidarcodec.apps.publisher.publisher import Rate
from lidarcodec.apps.recorder import Record, RecordAs
from lidarcodec.apps.vehicle import SensorPlan, Vehicle
from lidarcodec.budgets import FileTooLargeError, read_file
from lidarcodec.codecs import table
from lidarcodec.commands.endpoints import Given, endpoints_of
from lidarcodec.commands.publish.command import record_limits, say_begun, tell_of, vehicle_of
from lidarcodec.commands.running.stopping import stoppable
from lidarcodec.commands.settings import settings_of
from lidarcodec.errors import LidarCodecError, SettingsError, SourceError, reason_of, sentence_of
from lidarcodec.mounting import Mounting
from lidarcodec.network.shelf import look_in
from lidarcodec.sensors import read_calibration
from lidarcodec.settings import MAX_NAME, NAME_PATTERN, StreamSettings
from lidarcodec.sources import PacketSource, open_source
from lidarcodec.sources.mounts import Mounted, read_mounts
from lidarcodec.sources.poses import read_poses
from lidarcodec.sources.spec import LIVE
from lidarcodec.sources.spec import parse as parse_source
from lidarcodec.untrusted.yaml import YamlRefusedError, read_yaml

NOWHERE: Final[Mapping[str, Mounting]] = MappingProxyType({})
Name = Annotated[str, Field(pattern=f"^{NAME_PATTERN.pattern}$", max_length=MAX_NAME)]


class _Strict(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class RecordConfig(_Strict):
    """The recording on the vehicle; it does not depend on what is sent."""

    folder: Path
    form: RecordAs = Field(default="packets", alias="as")
    gb: float = Field(default=8.0, gt=0.0, le=1e6)


class KeepConfig(_Strict):
    """What the vehicle keeps exactly. size: for example `64GB`;  mark_when: as `--mark-when`"""

    folder: Path
    size: str
    mark_when: tuple[str, ...] = ()

    @field_validator("size")
    @classmethod
    def _size(cls, value: str) -> str:
        try:
            bytes_of(value)
        except SettingsError as error:
            raise ValueError(str(error)) from None
        return value

    @field_validator("mark_when")
    @classmethod
    def _mark_when(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        try:
            conditions_of(value)
        except SettingsError as error:
            raise ValueError(str(error)) from None
        return value


class SensorConfig(_Strict):
    """One sensor. settings: fields of StreamSettings, otherwise settings of the codec, as in `--set`

    link: as in `--link`;  mount: in place of the one in the vehicle's `mounts`
    """

    name: Name
    source: str
    calibration: Path | None = None
    poses: Path | None = None
    poses_of: Literal["sensor", "vehicle"] = "sensor"
    mount: Mounting | None = None
    link: str | None = None
    codec: str | None = None
    settings: dict[str, Any] = {}
    rate: float | Literal["max"] | None = None
    record: RecordConfig | None = None
    keep: KeepConfig | None = None
    original: bool = False

    @field_validator("mount", mode="before")
    @classmethod
    def _mount(cls, value: object) -> Mounting | None:
        try:
            return None if value is None else Mounting.of_values(value)
        except SettingsError as error:
            raise ValueError(str(error)) from None

    @field_validator("rate")
    @classmethod
    def _rate(cls, value: float | str | None) -> float | str | None:
        if isinstance(value, float) and not 0.01 <= value <= 1000.0:
            raise ValueError("write frames a second, from 0.01 to 1000, or max")
        return value

    @model_validator(mode="after")
    def _settings_fit(self) -> SensorConfig:
        try:
            self.stream_settings()
        except LidarCodecError as error:
            raise ValueError(f"settings: {error}") from None
        return self

    def stream_settings(self) -> StreamSettings:
        """The settings, checked against the codec. Raises SettingsError or UnknownNameError."""
        return settings_of(self.codec, self.settings, self.link)

    def check_files(self, place: str) -> None:
        """Check everything that can be checked before the sensor is on. place: of this sensor in the file

        Raises SettingsError with the name of the field.
        """
        try:
            field = "settings"
            table.check_files(self.stream_settings())
            field = "source"
            parse_source(self.source)
            if self.calibration is not None:
                field = "calibration"
                read_calibration(self.calibration)
            if self.poses is not None:
                field = "poses"
                read_poses(self.poses)
        except (LidarCodecError, OSError) as error:
            raise SettingsError(f"{place}.{field}: {error}", field) from None

    def mounted(self, mounts: Mapping[str, Mounting] = NOWHERE) -> Mounted:
        """Where it sits. mounts: those of the vehicle

        Raises SettingsError if poses of the vehicle need it, and it is not known.
        """
        mount = self.mount or mounts.get(self.name)
        if self.poses_of == "vehicle" and (mount is None or self.poses is None):
            raise SettingsError("`poses_of: vehicle` needs `poses`, and `mount` or `mounts`", "poses_of")
        return Mounted(mount, self.poses_of == "vehicle")

    def plan(self, mounts: Mapping[str, Mounting] = NOWHERE) -> SensorPlan:
        """The plan of this sensor for a Vehicle. mounts: as of `mounted`"""
        mounted = self.mounted(mounts)
        rate: Rate | None = self.rate
        record, keep = self.record, self.keep
        return SensorPlan(
            self.name,
            partial(_opened, self, mounted),
            self.stream_settings(),
            live=parse_source(self.source).scheme in LIVE,
            rate=rate,
            with_poses=self.poses is not None,
            mount=mounted.mount,
            record=None if record is None else Record(record.folder, record.form, record_limits(record.gb)),
            keep=None if keep is None else Keep(keep.folder, bytes_of(keep.size), keep.mark_when),
            original=self.original,
        )


def _opened(sensor: SensorConfig, mounted: Mounted) -> PacketSource:
    source = open_source(sensor.source, calibration=sensor.calibration, poses=sensor.poses)
    mounted.given_to(source)
    return source


class VehicleConfig(_Strict):
    """A vehicle: its network, and its sensors. mounts: a file with the mountings of its sensors"""

    vehicle: Name | None = None
    connect: list[str] = []
    listen: list[str] = []
    zenoh_config: Path | None = None
    weights_dir: Path | None = None
    mounts: Path | None = None
    sensors: list[SensorConfig] = Field(min_length=1, max_length=64)

    @model_validator(mode="after")
    def _apart(self) -> VehicleConfig:
        folders = [sensor.record.folder for sensor in self.sensors if sensor.record]
        for what, found in (("name", [sensor.name for sensor in self.sensors]), ("record folder", folders)):
            twice = next((one for number, one in enumerate(found) if one in found[:number]), None)
            if twice is not None:
                raise ValueError(f"two sensors have the {what} '{twice}'")
        return self


def parse(text: str, where: str, weights_dir: Path | None = None) -> VehicleConfig:
    """The configuration in a text. From then on its `weights_dir`, or the given one, is the folder of weights.

    Raises SettingsError with the name of the field.
    """
    try:
        values = read_yaml(text)
    except YamlRefusedError as error:
        raise SettingsError(f"{where}: {error}", "config") from None
    if not isinstance(values, dict):
        raise SettingsError(f"{where} has no fields: start with `vehicle: NAME` and `sensors:`", "config")
    folder = weights_dir or values.get("weights_dir")
    try:
        if isinstance(folder, str | Path):
            look_in(Path(folder))  # before the settings of sensors are checked, because they can name weights in it
        return VehicleConfig.model_validate(values)
    except SettingsError as error:
        raise SettingsError(str(error) if weights_dir else f"{where}: {error}", "weights_dir") from None
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"])
        text = reason_of(first)
        if place:
            text = f"{place}.{text}" if text.startswith("settings: ") else sentence_of(place, first)
        raise SettingsError(f"{where}: {text}", place) from None


def read(path: Path, weights_dir: Path | None = None) -> VehicleConfig:
    """The configuration in a file; weights_dir: as in `parse`.

    Raises SettingsError if it is missing, too long, or invalid.
    """
    try:
        text = read_file(path, "config").decode()
    except OSError as error:
        raise SettingsError(f"{path}: {error.strerror}", "config") from None
    except UnicodeDecodeError:
        raise SettingsError(f"{path} is not text in UTF-8", "config") from None
    except FileTooLargeError as error:
        raise SettingsError(f"{path}: {error}", "config") from None
    return parse(text, str(path), weights_dir)


def run(
    path: Path,
    vehicle: str | None,
    given: Given,
    health_file: Path | None,
    weights_dir: Path | None,
    as_json: bool = False,
) -> None:
    """Publish until every source has ended or a signal arrives. The command line overrides the file."""
    config = read(path, weights_dir)
    mounts = {} if config.mounts is None else read_mounts(config.mounts)
    for number, sensor in enumerate(config.sensors):
        sensor.check_files(f"{path}: sensors.{number}")
    connect, listen, zenoh_config = given
    if not (connect or listen or zenoh_config):
        connect, listen, zenoh_config = config.connect, config.listen, config.zenoh_config
    endpoints = endpoints_of((connect, listen, zenoh_config))
    name = vehicle_of(vehicle or config.vehicle, endpoints)
    running = Vehicle(name, [sensor.plan(mounts) for sensor in config.sensors], endpoints)
    streams = [f"{name}/{sensor.name}" for sensor in config.sensors]
    health = health_file_or_nothing(health_file, running.states)
    ready = told_ready(f"publishing {', '.join(streams)}", running.states)
    with running, stoppable(running.interrupt) as stopped, health, ready:
        running.opened()
        say_begun(streams, endpoints)
        running.wait()
        failures = {} if stopped() else running.failures()
    try:
        tell_of(running.statuses(), as_json)
    finally:  # failed sensors are reported first
        if failures:
            told = "; ".join(f"{name}/{sensor}: {error}" for sensor, error in failures.items())
            raise SourceError(f"not everything was published: {told}")

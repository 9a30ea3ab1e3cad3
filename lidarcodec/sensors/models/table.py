"""The models of sensors beside the HDL-64E by name. A new one is one file and one line here.

>>> sensor_named("vlp16").title
'Velodyne VLP-16 (Puck, Puck LITE)'
"""

from __future__ import annotations

import importlib
from collections.abc import Iterator, Sequence
from functools import lru_cache
from typing import Final, NamedTuple, cast

import numpy as np

from lidarcodec.errors import CalibrationError, UnknownNameError
from lidarcodec.sensor_model import HDL64E, POINTCLOUD2, Calibration, SensorModel
from lidarcodec.sensors.clouds.sensor import cloud_evidence
from lidarcodec.sensors.images import Sensor
from lidarcodec.sensors.models.block_sensor import BlockSensor
from lidarcodec.sensors.models.ouster.sensor import METADATA_URL, bare_sensors, sensor_from
from lidarcodec.units import POSITION_PORT

PACKETS: Final = "packets"
"""Name of the model that takes any UDP payload: its packets are carried, and have no images."""

_MODELS: Final = {
    "vlp16": "lidarcodec.sensors.models.vlp16:SENSOR",
    "puck_hires": "lidarcodec.sensors.models.vlp16:HIRES",
    "hdl32e": "lidarcodec.sensors.models.hdl32e:SENSOR",
    "vlp32c": "lidarcodec.sensors.models.vlp32c:SENSOR",
    "vls128": "lidarcodec.sensors.models.vls128:SENSOR",
    "pandar40p": "lidarcodec.sensors.models.pandar40p:SENSOR",
    "pandar64": "lidarcodec.sensors.models.pandar64:SENSOR",
    "qt64": "lidarcodec.sensors.models.qt64:SENSOR",
    "qt128": "lidarcodec.sensors.models.qt128:SENSOR",
    "xt16": "lidarcodec.sensors.models.xt:XT16",
    "xt32": "lidarcodec.sensors.models.xt:XT32",
    "xt32m": "lidarcodec.sensors.models.xt:XT32M",
}
"""Name -> module and object."""

OUSTERS: Final = tuple(f"os{family}-{rows}" for family in ("0", "1", "2", "dome") for rows in (16, 32, 64, 128))
"""Ouster's models. Their packets are understood by the metadata of the unit, the `description` of a SensorModel."""


LOOKED_AT: Final = 64
"""Payloads that are looked at as messages."""


class Detected(NamedTuple):
    """The model that sent a stream, and why it must be this one, as a sentence for people."""

    model: str
    evidence: str


def names() -> tuple[str, ...]:
    """All names that `--model` takes."""
    return (HDL64E, *_MODELS, *OUSTERS, POINTCLOUD2, PACKETS)


def is_ouster(model: str) -> bool:
    """Whether a model is an Ouster, with metadata or without."""
    return model in OUSTERS or model in bare_sensors()


def frame_id_of(model: str) -> str:
    """What the coordinates of a sensor's points are called in ROS, unless a name was given: `velodyne` as its driver
    calls them, else the model.

    >>> frame_id_of("hdl64e"), frame_id_of("vlp16"), frame_id_of("xt32m"), frame_id_of("os1-128")
    ('velodyne', 'velodyne', 'xt32m', 'os1-128')
    """
    is_velodyne = model == HDL64E or (model in _MODELS and sensor_named(model).title.startswith("Velodyne"))
    return "velodyne" if is_velodyne else model


def aside_name(model: str) -> str:
    """What the packets are called that this sensor sends beside its data: of the inertial unit, or of positions."""
    return "IMU packet" if is_ouster(model) else "position packet"


def is_known(model: str) -> bool:
    """Whether a SensorModel may be of this model: all of `names`, and Ousters of which only the packets are known."""
    return model in names() or is_ouster(model)


@lru_cache(maxsize=64)
def sensor_named(model: str) -> Sensor:
    """The sensor of that name, without a unit's own description.

    Raises UnknownNameError; CalibrationError for an Ouster, which needs its description.
    """
    if model in OUSTERS:
        raise CalibrationError(f"{model} needs its metadata: save {METADATA_URL} as NAME.json beside NAME.pcap")
    if is_ouster(model):
        return bare_sensors()[model]
    if model not in _MODELS:
        raise UnknownNameError("sensor model", model, names())
    module, _, name = _MODELS[model].partition(":")
    return cast(Sensor, getattr(importlib.import_module(module), name))


def sensor_of(sensor: SensorModel) -> Sensor | None:
    """How packets of this sensor become images; None for a sensor whose packets are only carried, and for clouds.

    Raises UnknownNameError for a model that this build does not know, CalibrationError for an Ouster's description that
    is not that of this sensor.
    """
    if sensor.model in (PACKETS, POINTCLOUD2):
        return None
    return _described(sensor) if sensor.model in OUSTERS else sensor_named(sensor.model)


def _described(sensor: SensorModel) -> Sensor:
    family = sensor_from(sensor.description)
    if (family.name, family.layout.rows, family.range_step_m) != (sensor.model, sensor.rows, sensor.range_step_m):
        raise CalibrationError(f"the description of a {family.name} does not fit a {sensor.model}")
    return family


def block_models() -> tuple[str, ...]:
    """Names of the sensors that send blocks."""
    return tuple(_MODELS)


def block_sensors() -> Iterator[BlockSensor]:
    """The sensors that send blocks."""
    for name in _MODELS:
        yield cast(BlockSensor, sensor_named(name))


def any_packets() -> SensorModel:
    """The SensorModel of a sensor that nobody knows: packets without images."""
    no_beam = Calibration.from_values({"vert_correction_rad": np.zeros(1)})
    return SensorModel("unknown sensor", no_beam, "generic", model=PACKETS)


def auxiliary_port(model: str, data_port: int) -> int:
    """The port to which a sensor sends what is not data, by default: a Velodyne its position packets, an Ouster those
    of its inertial unit."""
    return data_port + 1 if is_ouster(model) else POSITION_PORT


def detect(payloads: Sequence[bytes]) -> Detected | None:
    """The model that took most of these payloads, and more than half of those of its size; None: it is none here."""
    best: Detected | None = None
    most = 0
    sizes = {len(payload) for payload in payloads}
    for name, sensor in ((name, sensor_named(name)) for name in (*_MODELS, *bare_sensors())):
        if not sizes & sensor.packet_sizes:
            continue
        right = [payload for payload in payloads if len(payload) in sensor.packet_sizes]
        taken = [payload for payload in right if sensor.layout_of(payload) is not None]
        if len(taken) > most and 2 * len(taken) > len(right):
            best, most = Detected(name, sensor.evidence(taken[0]) or ""), len(taken)
    clouds = [told for payload in payloads[:LOOKED_AT] if (told := cloud_evidence(payload)) is not None]
    return Detected(POINTCLOUD2, clouds[0]) if best is None and 2 * len(clouds) > len(payloads[:LOOKED_AT]) else best

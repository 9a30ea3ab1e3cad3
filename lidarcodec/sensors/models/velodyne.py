"""The Velodyne models that send blocks, and which of them sent a stream."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from lidarcodec.sensors.models import hdl32e, vlp16, vlp32c, vls128
from lidarcodec.sensors.models.block_sensor import most_likely
from lidarcodec.sensors.models.velodyne_packet import VelodyneSensor

SENSORS: Final[tuple[VelodyneSensor, ...]] = (
    vlp16.SENSOR,
    vlp16.HIRES,
    hdl32e.SENSOR,
    vlp32c.SENSOR,
    vls128.SENSOR,
)


def detect(payloads: Sequence[bytes]) -> VelodyneSensor | None:
    """The model that sent these payloads: the one that takes most, and more than half of those of its packets' size.

    None if there is no such model, as for an HDL-64E.
    """
    return most_likely(SENSORS, payloads)

"""The Hesai models that send blocks, and which of them sent a stream."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from lidarcodec.sensors.models import pandar40p, pandar64, qt64, qt128, xt16, xt32, xt32m
from lidarcodec.sensors.models.block_sensor import most_likely
from lidarcodec.sensors.models.hesai_packet import HesaiSensor

SENSORS: Final[tuple[HesaiSensor, ...]] = (
    pandar40p.SENSOR,
    pandar64.SENSOR,
    qt64.SENSOR,
    qt128.SENSOR,
    xt16.SENSOR,
    xt32.SENSOR,
    xt32m.SENSOR,
)


def detect(payloads: Sequence[bytes]) -> HesaiSensor | None:
    """The model that sent these payloads: the one that takes most, and more than half of those of its packets' size.

    None if there is no such model.
    """
    return most_likely(SENSORS, payloads)

"""ModelWatch: notices that a live sender's packets are no longer those of the sensor that was recognised."""

from __future__ import annotations

from typing import Final

from lidarcodec.sensor_model import SensorModel
from lidarcodec.sensors.models.ouster.sensor import OusterSensor
from lidarcodec.sensors.models.table import detect, sensor_of
from lidarcodec.sensors.recognise import warn_if_another
from lidarcodec.units import PACKET_BYTES

LOOK_EVERY: Final = 16
"""One packet of so many is looked at."""
ODD_IN_A_ROW: Final = 32
"""Packets looked at, one after the other, that must be of something else: 512 packets, 0.15 to 0.7 s."""
PATIENCE: Final = 4
"""Each look that finds the same sensor again makes the next so many times rarer."""
MOST_IN_A_ROW: Final = ODD_IN_A_ROW * PATIENCE**4


class NamedModel:
    """Warns once if the first packets look like those of another model than `--model` says."""

    def __init__(self, model: str, label: str) -> None:
        self._model, self._label = model, label
        self._first: list[bytes] = []

    def push(self, payload: bytes) -> None:
        """Look at a packet."""
        if len(self._first) < ODD_IN_A_ROW:
            self._first.append(payload)
            if len(self._first) == ODD_IN_A_ROW:
                warn_if_another(self._model, self._first, self._label)


class ModelWatch:
    """Looks at one packet in sixteen: is it of this sensor, and, for an Ouster, of the same start?

    An Ouster starts anew when its settings change, and counts that in its packets (`init_id`). Then its metadata must
    be asked for again, because points depend on it.
    """

    def __init__(self, sensor: SensorModel) -> None:
        """sensor: the one that was recognised; `watch` it before packets are pushed."""
        self._limit = ODD_IN_A_ROW
        self.watch(sensor)

    def watch(self, sensor: SensorModel) -> None:
        """Compare with this sensor from now on."""
        self._family = None if sensor.is_hdl64e else sensor_of(sensor)
        self._start: int | None = None
        self._seen = self._odd = 0

    def found_the_same(self) -> None:
        """The packets are of the same sensor after all: wait longer before the next look."""
        self._limit = min(self._limit * PATIENCE, MOST_IN_A_ROW)
        self._odd = 0

    def push(self, payload: bytes) -> bool:
        """Whether the sensor must be recognised anew, from this packet on."""
        self._seen += 1
        if self._seen % LOOK_EVERY:
            return False
        self._odd = self._odd + 1 if self._is_odd(payload) else 0
        return self._odd >= self._limit

    def _is_odd(self, payload: bytes) -> bool:
        if self._family is None:
            return len(payload) != PACKET_BYTES or detect([payload]) is not None
        if self._family.layout_of(payload) is None:
            return True
        if not isinstance(self._family, OusterSensor):
            return False
        start = self._family.layout.start_of(payload)
        if self._start is None:
            self._start = start
        return start != self._start

"""Reads packets turn by turn, so that a stopped command can be continued with `--skip`."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from itertools import chain

from lidarcodec.assembly.any_sensor import TurnWatch
from lidarcodec.assembly.rotation import RotationWatch
from lidarcodec.packet import Packet
from lidarcodec.sensor_model import SensorModel
from lidarcodec.units import FRAME_PACKETS


def turns_of(sensor: SensorModel) -> RotationWatch | TurnWatch:
    """What sees in the packets of this sensor where turns begin."""
    return RotationWatch() if sensor.is_hdl64e else TurnWatch(sensor)


class Turns:
    """Packets in turns. After a signal they end with the current turn.

    of: number of data packets in a turn; None: turns as the sensor's rotation says, the first one may be short
    watch: sees where turns begin; None: those of an HDL-64E
    most: they end after this number of turns, without those that were passed over; None: with the packets
    packets: data packets so far;  positions: position packets among them;  turns: turns that were begun
    cut: whether packets were left when a signal arrived;  complete: whether `most` turns were there
    """

    def __init__(
        self,
        packets: Iterable[Packet],
        stopped: Callable[[], bool],
        tick: Callable[[], None],
        of: int | None = FRAME_PACKETS,
        most: int | None = None,
        watch: RotationWatch | TurnWatch | None = None,
    ) -> None:
        self.of, self.most = of, most
        self._source, self._stopped, self._tick = iter(packets), stopped, tick
        self._rotation = watch or RotationWatch()
        self._first: list[Packet] = []  # the first packets after those that were passed over
        self.packets = self.positions = self.turns = 0
        self.cut = self.complete = False

    def pass_over(self, turns: int) -> None:
        """Skip that many turns."""
        passed = number = 0
        positions: list[Packet] = []
        for packet in self._source if turns else ():
            if packet.position:
                positions.append(packet)
                continue
            if self._begins(packet, number):
                if passed == turns:  # positions behind a turn by rotation are in its frame, else in the next one
                    self._first = [*(() if self.of is None else positions), packet]
                    return
                if self._stopped():
                    self.cut = True
                    return
                passed += 1
            positions.clear()
            number += 1

    def __iter__(self) -> Iterator[Packet]:
        if self.cut:
            return
        for packet in chain(self._first, self._source):
            if packet.position:
                self.positions += 1
                yield packet
                continue
            if self._begins(packet, self.packets):
                if self.turns == self.most:
                    self.complete = True
                    return
                if self._stopped():
                    self.cut = True
                    return
                if self.packets:
                    self._tick()
                self.turns += 1
            self.packets += 1
            yield packet

    def _begins(self, packet: Packet, number: int) -> bool:
        """Whether a turn begins with this data packet; `number` were before it."""
        if self.of is not None:
            return number % self.of == 0
        return self._rotation.begins(packet.payload) or number == 0

"""Reads packets turn by turn, so that a stopped command can be continued with `--skip`."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

from lidarcodec.packet import Packet
from lidarcodec.units import FRAME_PACKETS


class Turns:
    """Packets in turns of `of` data packets. After a signal they end with the current turn.

    packets: data packets so far;  positions: position packets among them
    cut: whether packets were left when a signal arrived
    """

    def __init__(
        self, packets: Iterable[Packet], stopped: Callable[[], bool], tick: Callable[[], None], of: int = FRAME_PACKETS
    ) -> None:
        self.of = of
        self._source, self._stopped, self._tick = iter(packets), stopped, tick
        self.packets = self.positions = 0
        self.cut = False

    def pass_over(self, turns: int) -> None:
        """Skip that many turns."""
        number = 0
        while number < turns * self.of:
            if number % self.of == 0 and self._stopped():
                self.cut = True
                return
            packet = next(self._source, None)
            if packet is None:
                return
            number += not packet.position

    def __iter__(self) -> Iterator[Packet]:
        if self.cut:
            return
        for packet in self._source:
            if packet.position:
                self.positions += 1
                yield packet
                continue
            if self.packets % self.of == 0:
                if self._stopped():
                    self.cut = True
                    return
                if self.packets:
                    self._tick()
            self.packets += 1
            yield packet

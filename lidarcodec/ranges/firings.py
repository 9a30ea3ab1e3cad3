"""How many columns a sensor had fired before a frame: part of its error comes again every so many firings.

An HDL-64E measures a wall that stands still a little farther in one firing and a little nearer in the next: of each
laser a pattern of a millimetre or so that comes again after 24 firings. Coders of ranges learn it, as long as somebody
tells them where in the pattern a frame begins. Only the encoder counts, and sends the count; where it is wrong, that
costs bits until the pattern has been learned anew, and nothing else.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from lidarcodec.frame import Frame
from lidarcodec.packet_clock import PLAUSIBLE_INTERVAL_US, clock_steps

_KEPT_STEPS: Final = 400
"""From packet to packet: slabs have few of their own."""
_FEWEST_STEPS: Final = 4
_JUMP_US: Final = -1_000_000
"""A clock that goes back by more was set; by less, packets changed places."""


@dataclass(frozen=True)
class _Sent:
    """What is kept of a frame."""

    name: tuple[int, int]
    width: int
    gps_us: npt.NDArray[np.uint32]  # (P,)
    columns_a_packet: int


class FiringCounter:
    """Counts the columns from frame to frame, those of packets that were lost and of frames that were left out too.

    What the packets' own clock says goes before what arrived: a sensor sends them evenly. Where no clock runs evenly,
    frames are taken to follow on each other.
    """

    def __init__(self) -> None:
        self._count = 0
        self._last: _Sent | None = None
        self._steps: npt.NDArray[np.int64] = np.zeros(0, np.int64)

    def columns_before(self, frame: Frame) -> int:
        """Columns fired since the first frame that was asked for began; each may be asked for again."""
        last, this = self._last, _sent(frame)
        if last is not None and last.name == this.name:
            return self._count
        if last is not None:
            self._count += self._columns_between(last, this)
        self._last = this
        return self._count

    def _columns_between(self, last: _Sent, this: _Sent) -> int:
        """Columns from the beginning of one frame to that of the next."""
        steps = clock_steps(np.concatenate([last.gps_us, this.gps_us[:1]]))
        interval = self._interval(steps) if len(last.gps_us) and len(this.gps_us) else None
        if interval is None:
            return last.width
        packets = int(np.where(steps < _JUMP_US, 1, np.rint(steps / interval)).sum())
        return packets * last.columns_a_packet if packets >= len(steps) else last.width

    def _interval(self, steps: npt.NDArray[np.int64]) -> float | None:
        """Microseconds from one packet to the next, as far as they are known: the mean of the usual ones."""
        least, most = PLAUSIBLE_INTERVAL_US
        plausible = steps[(steps >= least) & (steps <= most)]
        self._steps = np.concatenate([self._steps, plausible])[-_KEPT_STEPS:]
        if len(self._steps) < _FEWEST_STEPS:
            return None
        kept = np.sort(self._steps)
        usual = kept[(len(kept) - 1) // 2]
        return float(kept[np.abs(kept - usual) < usual / 2].mean())


def _sent(frame: Frame) -> _Sent:
    name, side = (frame.index, frame.stamp_ns), frame.side
    if side is None or not side.packets:
        return _Sent(name, frame.width, np.zeros(0, np.uint32), 0)
    return _Sent(name, frame.width, side.gps_us, int(np.bincount(side.columns_per_packet).argmax()))

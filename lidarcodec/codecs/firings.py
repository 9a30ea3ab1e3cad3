"""How many columns a sensor had fired before a frame: part of its error comes again every so many firings.

An HDL-64E measures a wall that stands still a little farther in one firing and a little nearer in the next: of each
laser a pattern of a millimetre or so that comes again after 24 firings. Coders of ranges learn it, as long as somebody
tells them where in the pattern a frame begins. Only the encoder counts, and sends the count; where it is wrong, that
costs bits until the pattern has been learned anew, and nothing else.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from lidarcodec.frame import Frame
from lidarcodec.side import SideInfo

_HOUR_US: Final = 3_600_000_000
_MOST_US: Final = 10_000
"""From one packet to the next; sensors send one in 0.3 to 1.5 ms."""


class FiringCounter:
    """Counts the columns from frame to frame, those of packets that were lost and of frames that were left out too.

    What a packet's own clock says goes before what arrived: a sensor sends its packets evenly. Without it, frames are
    taken to follow on each other.

    >>> counter = FiringCounter()
    """

    def __init__(self) -> None:
        self._count = 0
        self._before: Frame | None = None
        self._apart_us = 0.0  # packets, as far as is known

    def before(self, frame: Frame) -> int:
        """Columns fired from the first frame that was asked for until this one; each may be asked for again."""
        before = self._before
        if before is not None and frame.stamp_ns != before.stamp_ns:
            self._count += self._columns_since(before, frame)
        self._before = frame
        return self._count

    def _columns_since(self, before: Frame, frame: Frame) -> int:
        if before.side is None or frame.side is None or not before.side.packets or not frame.side.packets:
            return before.width
        steps = _apart(before.side.gps_us)
        self._learn(steps)
        if not self._apart_us:
            return before.width
        between = _apart(np.array([before.side.gps_us[-1], frame.side.gps_us[0]]))
        packets = int(np.rint(np.concatenate([steps, between]) / self._apart_us).sum())
        return packets * _columns_a_packet(before.side)

    def _learn(self, steps: npt.NDArray[np.float64]) -> None:
        """How far packets are apart, from some that are."""
        typical = float(np.median(steps)) if len(steps) else 0.0
        if 0 < typical <= _MOST_US:
            self._apart_us = float(steps[np.abs(steps - typical) < typical / 2].mean())


def _apart(gps_us: npt.NDArray[np.uint32]) -> npt.NDArray[np.float64]:
    """Microseconds from each packet to the next; clocks begin anew with every hour."""
    clock = gps_us.astype(np.int64)
    return ((clock[1:] - clock[:-1]) % _HOUR_US).astype(np.float64)


def _columns_a_packet(side: SideInfo) -> int:
    return int(np.bincount(side.columns_per_packet).argmax())

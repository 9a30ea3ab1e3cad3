"""The number of columns that a sensor fired before a frame: part of its error is periodic in it.

The range error of each laser of an HDL-64E has a pattern of about a millimetre with a period of 24 firings. Coders of
ranges learn it if they know where in the pattern a frame begins. The encoder counts and sends the count. A wrong count
costs bits until the coder has adapted, and nothing else.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from lidarcodec.frame import Frame
from lidarcodec.sensors.packet_clock import PLAUSIBLE_INTERVAL_US, clock_steps

_KEPT_STEPS: Final = 400
"""Steps of the clock from packet to packet that are kept, because a slab has few of its own."""
_FEWEST_STEPS: Final = 4
_JUMP_US: Final = -1_000_000
"""A clock that goes back further was set. If it goes back less, packets were reordered."""


@dataclass(frozen=True)
class _Sent:
    """The last frame."""

    name: tuple[int, int]
    width: int
    gps_us: npt.NDArray[np.uint32]  # (P,)
    columns_a_packet: int


class FiringCounter:
    """Counts the columns from frame to frame, with those of lost packets and of frames that were left out.

    It counts by the time stamps of packets, because a sensor sends packets evenly. Without an even clock it assumes
    that no frame is missing.
    """

    def __init__(self) -> None:
        self._count = 0
        self._last: _Sent | None = None
        self._steps: npt.NDArray[np.int64] = np.zeros(0, np.int64)

    def columns_before(self, frame: Frame) -> int:
        """Columns fired since the start of the first frame. The same frame may be asked for again."""
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
        """Microseconds from one packet to the next, the mean without outliers; None if too few are known."""
        least, most = PLAUSIBLE_INTERVAL_US
        plausible = steps[(steps >= least) & (steps <= most)]
        self._steps = np.concatenate([self._steps, plausible])[-_KEPT_STEPS:]
        if len(self._steps) < _FEWEST_STEPS:
            return None
        kept = np.sort(self._steps)
        usual = kept[(len(kept) - 1) // 2]
        return float(kept[np.abs(kept - usual) < usual / 2].mean())


def _sent(frame: Frame) -> _Sent:
    name, side = (frame.index, frame.stamp_ns), frame.blocks
    if side is None or not side.packets:
        return _Sent(name, frame.width, np.zeros(0, np.uint32), 0)
    return _Sent(name, frame.width, side.gps_us, int(np.bincount(side.columns_per_packet).argmax()))

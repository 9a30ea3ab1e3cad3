"""A packet's own clock: microseconds since the top of the hour, in its tail."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from lidarcodec.units import HOUR_US

PLAUSIBLE_INTERVAL_US: Final = (100, 2000)
"""An HDL-64 sends a packet every 288 us in single-return mode. With a median interval outside these limits, the tail
is not a clock."""


def clock_steps(gps_us: npt.NDArray[np.uint32], before: int | None = None) -> npt.NDArray[np.int64]:
    """Microseconds from each packet to the next, below 0 where the clock jumps back. The wrap at the top of the hour is
    not a jump.

    gps_us: (P,) uint32; before: time stamp of the packet before these, if there is one
    """
    stamps = gps_us.astype(np.int64)
    steps = np.diff(stamps if before is None else np.concatenate(([before], stamps)))
    whole: npt.NDArray[np.int64] = np.where(steps < -HOUR_US // 2, steps + HOUR_US, steps)
    return whole

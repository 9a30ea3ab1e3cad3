"""Lost packets and time jumps, by the packets' own clock."""

from __future__ import annotations

from collections import Counter

import numpy as np
import numpy.typing as npt

from lidarcodec.sensors.packet_clock import PLAUSIBLE_INTERVAL_US, clock_steps

LONGEST_GAP_US = 1_000_000


def count_discontinuities(gps_us: npt.NDArray[np.uint32], before: int | None) -> Counter[str]:
    """Counts of `lost packets` and `time jumps` in packet time stamps; `before` is the stamp of the packet before.

    gps_us: (P,) uint32, microseconds since the top of the hour. If the tails are not a running clock (the published
    HDL-64E S3 capture sends alternating constants), nothing is counted.
    """
    counts: Counter[str] = Counter()
    steps = clock_steps(gps_us, before)
    if len(steps) < 2:
        return counts
    interval = float(np.median(steps))
    if not PLAUSIBLE_INTERVAL_US[0] <= interval <= PLAUSIBLE_INTERVAL_US[1]:
        return counts
    jumps = (steps < 0) | (steps > LONGEST_GAP_US)
    beside_jump = np.convolve(jumps, [1, 1, 1])[1:-1] > 0  # the steps beside a jump are not losses
    gaps = (steps > 1.5 * interval) & ~beside_jump
    if gaps.any():
        counts["lost packets"] = int(np.rint(steps[gaps] / interval - 1).sum())
    if jumps.any():
        counts["time jumps"] = int(np.count_nonzero(jumps))
    return counts

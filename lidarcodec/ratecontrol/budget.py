"""Budget: the bits that a stream has spent compared with its target, by the time of the sensor.

Only the time of sent frames counts. So replaced frames and pauses save no bits that a later frame could spend at once.

>>> budget = spend(Budget(), seconds=0.1, bits=120e3, target_bps=1e6)
>>> round(budget.debt_s, 6), kbps(budget, 5.0)
(0.02, 1200.0)
>>> share(budget, seconds=0.1, unit_s=0.1, target_bps=1e6) < 1e5
True
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

WINDOW_S: Final = 5.0
BIN_S: Final = 0.1
"""Slabs are remembered in bins of this length, so that a window never has more than WINDOW_S / BIN_S + 1 entries."""
REPAY_S: Final = 0.4
"""Time constant of repaying a debt: four frames. With a shorter one noise would lower the quality of good frames; with
a longer one a change of scene could exceed the one-second limit."""
MAX_DEBT_S: Final = 0.3
MAX_IDLE_S: Final = 0.05
"""Limit of debt and savings of a codec at the end of its knob. Otherwise it would repay for minutes afterwards."""
SWING: Final = 0.35
"""Limit of the effect of debt on one frame, so that one frame cannot spoil the next."""


@dataclass(frozen=True)
class Budget:
    """debt_s: bits spent too much, in seconds of the target bitrate; window: (seconds, bits), newest last, for the last
    five seconds or since the target was set."""

    debt_s: float = 0.0
    window: tuple[tuple[float, float], ...] = ()


def spend(budget: Budget, seconds: float, bits: float, target_bps: float, *, idle: bool = False) -> Budget:
    """The budget after a message of `bits` that covers `seconds`. idle: whether the knob was at the end towards which
    the target would move it"""
    limit = MAX_IDLE_S if idle else MAX_DEBT_S
    debt = min(max(budget.debt_s + bits / target_bps - seconds, -limit), limit)
    window = list(budget.window)
    if window and window[-1][0] + seconds <= BIN_S:
        window[-1] = (window[-1][0] + seconds, window[-1][1] + bits)
    else:
        window.append((seconds, bits))
    covered = sum(length for length, _ in window)
    while len(window) > 1 and covered - window[0][0] >= WINDOW_S:
        covered -= window.pop(0)[0]
    return Budget(debt, tuple(window))


def share(budget: Budget, seconds: float, unit_s: float, target_bps: float, repay_s: float = REPAY_S) -> float:
    """Bits for a frame that covers `seconds`, in a message that covers `unit_s`."""
    repaid = min(1.0, unit_s / repay_s) * budget.debt_s / unit_s
    return target_bps * seconds * (1.0 - min(max(repaid, -SWING), SWING))


def kbps(budget: Budget, seconds: float) -> float | None:
    """Mean kbit/s of the last `seconds`, or since the start; None before the first message."""
    covered = bits = 0.0
    for length, size in reversed(budget.window):
        used = min(length, seconds - covered)
        covered += used
        bits += size * used / length
        if covered >= seconds:
            break
    return bits / covered / 1e3 if covered > 0 else None


def covered_s(budget: Budget) -> float:
    """Seconds that the window covers, up to about five."""
    return sum(length for length, _ in budget.window)

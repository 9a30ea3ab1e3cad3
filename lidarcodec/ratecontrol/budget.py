"""Budget: what a stream has spent against its target, on the clock of the sensor.

Time is that which the frames cover: replaced frames and pauses earn nothing that a later frame could spend in one go.

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
"""A debt is paid back with this time constant: four frames. Shorter makes good frames pay for noise, longer lets a
scene change reach the one-second limit."""
MAX_DEBT_S: Final = 0.3
MAX_IDLE_S: Final = 0.05
"""What a codec that is at the end of its knob may owe or save: else it would pay for minutes once it has room again."""
SWING: Final = 0.35
"""How far debt may move the budget of a frame: none is to be spoilt by the one before it."""


@dataclass(frozen=True)
class Budget:
    """debt_s: seconds of the target's bits that were spent too much; window: (seconds, bits), the newest last, which
    cover the last five seconds or all since the target was set."""

    debt_s: float = 0.0
    window: tuple[tuple[float, float], ...] = ()


def spend(budget: Budget, seconds: float, bits: float, target_bps: float, *, idle: bool = False) -> Budget:
    """The budget after a message of `bits` that covers `seconds`. idle: the knob was at its end, on the side that the
    target asks for."""
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
    """Bits for a frame that covers `seconds`, one of those that go into a message which covers `unit_s`."""
    repaid = min(1.0, unit_s / repay_s) * budget.debt_s / unit_s
    return target_bps * seconds * (1.0 - min(max(repaid, -SWING), SWING))


def kbps(budget: Budget, seconds: float) -> float | None:
    """Mean kbit/s of the last `seconds`, or of all there is; None before the first message."""
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

"""The motor of a spinning sensor: positions over time, and times over positions.

A controller keeps the mean speed; around it the speed swings by a few tenths of a percent.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

Numbers = npt.NDArray[np.int64]

TURN_NS: Final = 100_000_000
"""10 turns a second."""
SWINGS: Final = ((2.9, 0.0016), (0.83, 0.0009))
"""Period in seconds and share of the speed, of each swing."""
TURN: Final = 36_000
"""Steps of 0.01 degree of a turn."""


class Encoder:
    """Where the head of a block sensor looks. seed: where it starts and where its swings are."""

    def __init__(self, seed: int) -> None:
        self._start, *self._phases = np.random.Generator(np.random.PCG64(seed)).random(1 + len(SWINGS)).tolist()

    def azimuth(self, t_ns: Numbers) -> npt.NDArray[np.uint16]:
        """Position, 0.01 degree clockwise, at times in ns since the start of the drive."""
        seconds = t_ns * 1e-9
        turns = self._start + t_ns / TURN_NS
        for (period, share), phase in zip(SWINGS, self._phases, strict=True):
            turns = turns + share * period * 1e9 / TURN_NS / (2 * np.pi) * np.sin(
                2 * np.pi * (seconds / period + phase)
            )
        steps: npt.NDArray[np.uint16] = (np.floor(turns * TURN).astype(np.int64) % TURN).astype(np.uint16)
        return steps


def jitter_ns(numbers: Numbers, most: int) -> Numbers:
    """For each number one of 0 to `most` that looks random and is always the same (a step of SplitMix64)."""
    mixed = numbers.astype(np.uint64) * np.uint64(0x9E3779B97F4A7C15)
    mixed = (mixed ^ (mixed >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    mixed ^= mixed >> np.uint64(31)
    return (mixed % np.uint64(most + 1)).astype(np.int64)

"""`voxel`: keeps one return in each cubic voxel, with a voxel size that fits the budget. It takes 4 ms, and no network
does much better.

Near surfaces have thousands of redundant returns and lose most of them. Far surfaces, which a localiser needs, keep
their returns.
"""

from __future__ import annotations

from typing import Any

from lidarcodec.frame import Frame
from lidarcodec.reduction.base import DEFAULT_SEED, Budget, Reducer, Reduction, with_kept
from lidarcodec.reduction.spread import Spread, returns_of


class Voxel(Reducer):
    """Voxel sampling."""

    def __init__(self, budget: Budget, argument: str | None = None, seed: int = DEFAULT_SEED) -> None:
        super().__init__(budget, argument, seed)
        self._spread = Spread(seed)

    def reduce(self, frame: Frame) -> Frame:
        """The frame with exactly as many returns as the budget allows."""
        returns = returns_of(frame)
        count = self.budget.of(len(returns.cells))
        if count == len(returns.cells):
            return frame
        return with_kept(frame, self._spread.choose(returns, count, frame))

    def reset(self) -> None:
        """Forgets the side of the voxels."""
        self._spread.reset()

    def report(self) -> dict[str, Any]:
        """`cell_m`: voxel size of the last frame."""
        return {"cell_m": round(self._spread.side_m, 3)}


REDUCTION = Reduction(Voxel)

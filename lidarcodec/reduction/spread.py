"""Spread: voxel sampling with the voxel size that fits a budget. All good reducers use it as their last step.

For a localiser it does not matter which return of a voxel is kept (docs/reduction.md). So the cheapest return is kept:
the one on the coarsest lattice of directions, then the first one in the range image. A reducer with scores keeps the
return with the best score.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from lidarcodec import _native
from lidarcodec.frame import Frame
from lidarcodec.motion.warp import beam_rows
from lidarcodec.reduction.base import DEFAULT_SEED, Cells
from lidarcodec.reduction.image_returns import levels_of, points_of
from lidarcodec.reduction.lots import exactly, lots

LENGTHS_PER_M: Final = 16_000
START_SIDE: Final = LENGTHS_PER_M // 2
"""Start of the first search for a voxel size: half a metre."""

SPARE: Final = 20
"""The search may give too many voxels, by one in so many. Then the most expensive returns are dropped."""

Mask = npt.NDArray[np.bool_]


class Returns(NamedTuple):
    """The N returns of a frame, in the order of the range image.

    xyz: (N, 3) int32, 1/16 mm, x forward, y left, z up; cells: (N,) uint32, row * W + column
    """

    xyz: npt.NDArray[np.int32]
    cells: Cells

    def only(self, chosen: Mask) -> Returns:
        """A part of the returns. chosen: (N,) bool"""
        return Returns(self.xyz[chosen], self.cells[chosen])


def returns_of(frame: Frame) -> Returns:
    """The returns of a frame that are still kept; 1.2 ms for 110,000."""
    if not frame.sensor.is_hdl64e:
        cells = np.flatnonzero(frame.valid).astype(np.uint32)
        return Returns(points_of(frame, cells, LENGTHS_PER_M), cells)
    ranges = frame.range_u16 if frame.keep is None else np.where(frame.keep, frame.range_u16, np.uint16(0))
    rows = beam_rows(frame.sensor)
    return Returns(*_native.returns_of(ranges, frame.azimuth, frame.fired.view(np.uint8), rows))


class Lattice(NamedTuple):
    """order: (N,) uint32, indices of the returns, cheapest first; level: (N,) uint8, 0 to 27, the fineness of the
    lattice of directions, then of rows, for each return"""

    order: npt.NDArray[np.uint32]
    level: npt.NDArray[np.uint8]


def lattice_of(returns: Returns, frame: Frame) -> Lattice:
    """The cost to send each return, as order and level."""
    if not frame.sensor.is_hdl64e:
        level = levels_of(returns.cells, frame.width)
        return Lattice(np.argsort(level, kind="stable").astype(np.uint32), level)
    rows = beam_rows(frame.sensor)
    return Lattice(*_native.lattice_of(returns.cells, frame.azimuth, frame.fired.view(np.uint8), rows))


def score_order(returns: Returns, scores: npt.NDArray[np.floating], frame: Frame, seed: int) -> npt.NDArray[np.uint32]:
    """(N,) uint32, indices of the returns, best score first; equal scores in random order. scores: (N,)"""
    scores = np.nan_to_num(scores.astype(np.float64), nan=-np.inf)
    by_lot = lots(returns.cells, seed, frame.index)
    return np.lexsort((by_lot, -scores)).astype(np.uint32)


class Spread:
    """Voxel sampling. The search for a voxel size begins with that of the last frame, so it is short."""

    def __init__(self, seed: int = DEFAULT_SEED) -> None:
        self.seed = seed
        self._side = START_SIDE

    def reset(self) -> None:
        """Begin the next search with half a metre."""
        self._side = START_SIDE

    @property
    def side_m(self) -> float:
        """Voxel size of the last frame."""
        return self._side / LENGTHS_PER_M

    def choose(self, returns: Returns, count: int, frame: Frame, order: npt.NDArray[np.uint32] | None = None) -> Cells:
        """Cells of exactly `count` returns, (count,) uint32, or of all if there are fewer; 4 ms for 110,000.

        order: indices of the returns; the first one of each voxel is kept, and random ones are dropped if there are too
        many. By default the cheapest returns are kept, within a voxel and among the voxels.
        """
        if count >= len(returns.cells):
            return returns.cells
        if order is not None:
            places, self._side = _native.pick_cells(returns.xyz, order, count, self._side)
            return exactly(returns.cells[places], returns.cells, count, self.seed, frame.index)
        lattice = lattice_of(returns, frame)
        more = min(count + count // SPARE, len(returns.cells))
        places, self._side = _native.pick_cells(returns.xyz, lattice.order, more, self._side)
        if len(places) < count:
            return exactly(returns.cells[places], returns.cells, count, self.seed, frame.index)
        by_lot = lots(returns.cells[places], self.seed, frame.index)
        cheapest: Cells = returns.cells[places[np.lexsort((by_lot, lattice.level[places]))[:count]]]
        return cheapest


def best_of_cells(
    frame: Frame,
    scores: npt.NDArray[np.floating],
    count: int,
    *,
    ground: Mask | None = None,
    ground_share: float = 0.0,
    over: float = 3.0,
    seed: int = DEFAULT_SEED,
) -> Cells:
    """Cells of exactly `count` returns, by score, at most one in a small voxel; all if there are fewer returns.

    Voxel sampling keeps the return with the best score of each voxel, `over` * `count` returns; the best `count` of
    them are chosen. With `over` 1 scores decide only within voxels. If `ground` is given, it gets its share of the
    budget and is chosen in the same way. If one part has too few returns, the other gets more.

    scores: (64, W) of any floating type; NaN is the worst score. ground: (64, W) bool
    """
    returns = returns_of(frame)
    count = min(count, len(returns.cells))
    of_return = scores.ravel()[returns.cells]
    is_ground = np.zeros(len(returns.cells), np.bool_) if ground is None else ground.ravel()[returns.cells]
    wanted = min(int(ground_share * count + 0.5), int(is_ground.sum()))
    wanted = max(wanted, count - int((~is_ground).sum()))
    parts = []
    for part, share in ((is_ground, wanted), (~is_ground, count - wanted)):
        some, some_scores = returns.only(part), of_return[part]
        order = score_order(some, some_scores, frame, seed)
        thinned = min(max(int(over * share + 0.5), share), len(order))
        spread = Spread(seed).choose(some, thinned, frame, order)
        rank = np.empty(len(order), np.uint32)
        rank[order] = np.arange(len(order), dtype=np.uint32)
        places = np.searchsorted(some.cells, spread)
        parts.append(spread[np.argsort(rank[places])[:share]])
    return np.concatenate(parts)

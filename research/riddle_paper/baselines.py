"""What the paper holds its predictor against: no learning, the last valid return or a straight line through two.

All predict from what a decoder has at that point: cells before this one in raster order, and which cells are valid.

>>> cells, valid = np.array([[100, 110, 0, 130]], np.int32), np.array([[True, True, False, True]])
>>> extrapolated(cells, valid).tolist()
[[0, 100, 120, 130]]
"""

from __future__ import annotations

import numpy as np

from research.riddle_paper.images import Cells, Mask, previous_valid


def extrapolated(cells: Cells, valid: Mask) -> Cells:
    """(H, W) int32, each cell on the straight line through the last two valid ones of its row, by column.

    With one, or none, the last valid cell.
    """
    columns = np.arange(cells.shape[1])
    guess = previous_valid(cells, valid)
    for row in range(len(cells)):
        last = np.maximum.accumulate(np.where(valid[row], columns, -1))
        one = np.concatenate([[-1], last[:-1]])
        two = np.where(one > 0, last[np.maximum(one - 1, 0)], -1)
        line = (one >= 0) & (two >= 0)
        here, first, second = columns[line], one[line], two[line]
        rise = (cells[row, first] - cells[row, second]) / (first - second)
        guess[row, line] = np.rint(cells[row, first] + rise * (here - first)).clip(0).astype(np.int32)
    return guess


def interpolated(cells: Cells, valid: Mask) -> Cells:
    """(H, W) int32, halfway between the last valid cell of the row and the one above; the one there is, if only one."""
    guess = previous_valid(cells, valid)
    above, there = np.zeros_like(cells), np.zeros_like(valid)
    above[1:], there[1:] = cells[:-1], valid[:-1]
    both = there & (guess > 0)
    return np.where(both, (guess + above + 1) // 2, guess).astype(np.int32)


def plane(cells: Cells, valid: Mask) -> Cells:
    """(H, W) int32, left + above - above left where all three are valid and side by side, else the last valid cell."""
    guess = previous_valid(cells, valid)
    three = np.zeros_like(valid)
    three[1:, 1:] = valid[1:, :-1] & valid[:-1, 1:] & valid[:-1, :-1]
    sloped = np.zeros_like(cells)
    sloped[1:, 1:] = cells[1:, :-1] + cells[:-1, 1:] - cells[:-1, :-1]
    return np.where(three, sloped.clip(0), guess).astype(np.int32)


BASELINES = {
    "previous valid": previous_valid,
    "linear extrapolation": extrapolated,
    "linear interpolation": interpolated,
    "plane": plane,
}
"""By name. The paper has previous valid and linear; `plane` is the gradient predictor of image coding."""

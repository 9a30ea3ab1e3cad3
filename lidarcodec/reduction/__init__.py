"""Reducers choose the returns of a frame to send. docs/reduction.md explains when to use which."""

from lidarcodec.reduction.base import Budget, Reducer, Reduction
from lidarcodec.reduction.spread import best_of_cells
from lidarcodec.reduction.table import check, make_reducer, names, reduction

__all__ = ["Budget", "Reducer", "Reduction", "best_of_cells", "check", "make_reducer", "names", "reduction"]

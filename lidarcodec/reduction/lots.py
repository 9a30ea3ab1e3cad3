"""Lots: random numbers for choices between equally good returns. They are the same on every machine.

The lot of a cell is a hash of its position, the index of the frame and the seed: SplitMix64 (Steele, Lea and Flood
2014).
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

Cells = npt.NDArray[np.uint32]
_MASK: Final = (1 << 64) - 1
_GOLDEN: Final = 0x9E3779B97F4A7C15


def lots(cells: Cells, seed: int, frame_index: int) -> npt.NDArray[np.uint64]:
    """(N,) uint64, the lots of cells of a frame."""
    start = (seed * _GOLDEN ^ (frame_index + 1) * 0xD1B54A32D192ED03) & _MASK
    z = (cells.astype(np.uint64) + np.uint64(1)) * np.uint64(_GOLDEN) ^ np.uint64(start)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


def drawn(cells: Cells, count: int, seed: int, frame_index: int) -> Cells:
    """`count` of the cells, drawn at random."""
    if count >= len(cells):
        return cells
    return cells[np.argpartition(lots(cells, seed, frame_index), count)[:count]]


def exactly(chosen: Cells, others: Cells, count: int, seed: int, frame_index: int) -> Cells:
    """`count` cells: a random part of the chosen ones if they are too many, or all of them and random others.

    others: may include chosen ones; chosen and others together are `count` or more
    """
    if len(chosen) >= count:
        return drawn(chosen, count, seed, frame_index)
    left = np.setdiff1d(others, chosen)
    return np.concatenate([chosen, drawn(left, count - len(chosen), seed, frame_index)])

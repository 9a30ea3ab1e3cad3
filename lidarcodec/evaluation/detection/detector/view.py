"""What the detector sees of a frame: a sector ahead of the sensor, from above.

Cells are 0.2 m wide. Each has a 1 in every layer of height in which it holds a return, the logarithm of how many
returns it holds, and the largest intensity.

>>> view = seen(np.array([[10.0, 0.0, -1.0], [-10.0, 0.0, -1.0]]), np.array([51, 9], np.uint8))
>>> view[:LAYERS].sum().item(), round(view[-1].max().item(), 3)
(1.0, 0.2)
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

DEPTH_M: Final = 48.0
"""The view is this deep and this wide."""
CELL_M: Final = 0.2
CELLS: Final = 240
LOWEST_M: Final = -2.2
LAYER_M: Final = 0.25
LAYERS: Final = 13
CHANNELS: Final = LAYERS + 2
HALF_DEG: Final = 40.0
"""Half the angle of the sector: about what the camera of KITTI sees, and so what is labelled there."""
COUNTED_DEG: Final = 37.0
NEAREST_M: Final = 3.0
FARTHEST_M: Final = 46.0
MARGIN_M: Final = 1.5
STRIDE: Final = 2
"""Cells of the view in a cell of the network's output, in each direction."""
OUT_M: Final = CELL_M * STRIDE
OUT_CELLS: Final = CELLS // STRIDE
Floats = npt.NDArray[np.float32]


def seen(points: npt.NDArray[np.floating], intensity: npt.NDArray[np.floating] | npt.NDArray[np.uint8]) -> Floats:
    """(CHANNELS, CELLS, CELLS) of points (N, 3) in the frame of the sensor, with intensities (N,) of 0 to 255; the
    first axis of cells is x, the second y. Cost: 5 ms."""
    x, y, z = np.asarray(points, np.float32).T
    inside = (
        (x > 0) & (x < DEPTH_M) & (np.abs(y) < DEPTH_M / 2) & (np.abs(y) < x * np.float32(np.tan(np.radians(HALF_DEG))))
    )
    inside &= (z >= LOWEST_M) & (z < LOWEST_M + LAYERS * LAYER_M)
    x, y, z = x[inside], y[inside], z[inside]
    cell = np.minimum((x / CELL_M).astype(np.intp), CELLS - 1) * CELLS
    cell += np.minimum(((y + DEPTH_M / 2) / CELL_M).astype(np.intp), CELLS - 1)
    layer = np.minimum(((z - LOWEST_M) / LAYER_M).astype(np.intp), LAYERS - 1)
    found = np.zeros((CHANNELS, CELLS * CELLS), np.float32)
    found[layer, cell] = 1
    found[-2] = np.log1p(np.bincount(cell, minlength=CELLS * CELLS)) * 0.4
    np.maximum.at(found[-1], cell, np.minimum(np.asarray(intensity, np.float32)[inside] / 255, 1))
    return found.reshape(CHANNELS, CELLS, CELLS)


def counted(middle: npt.NDArray[np.float64]) -> npt.NDArray[np.bool_]:
    """(N,) whether a place (N, 2 or 3) is well within the view: what is at its edge is neither missed nor false."""
    x, y = middle[:, 0], middle[:, 1]
    far = np.hypot(x, y)
    within = (x > 0) & (np.abs(y) < x * np.tan(np.radians(COUNTED_DEG))) & (far > NEAREST_M) & (far < FARTHEST_M)
    found: npt.NDArray[np.bool_] = within & (np.abs(y) < DEPTH_M / 2 - MARGIN_M)
    return found

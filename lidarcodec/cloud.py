"""Frame -> structured array of points in metres. The only place below the lossy codecs where ranges become floats."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from lidarcodec.frame import Frame

CLOUD_DTYPE = np.dtype(
    [("x", "f4"), ("y", "f4"), ("z", "f4"), ("intensity", "u1"), ("laser", "u1"), ("ring", "u1"), ("t_ns", "i8")]
)


def cloud_of(frame: Frame) -> npt.NDArray[np.void]:
    """Points of the frame's valid returns."""
    raise NotImplementedError

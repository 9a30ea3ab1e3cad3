"""Boxes around objects, in the frame of the sensor.

>>> boxes = upright(["car"], [7], np.array([[10.0, 0.0, -1.0]]), np.array([[4.0, 2.0, 1.5]]), np.array([0.0]))
>>> boxes.within(0, np.array([[11.9, 0.9, -1.0], [12.1, 0.0, -1.0]])).round(6).tolist()
[[1.9, 0.9, 0.0], [2.1, 0.0, 0.0]]
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from lidarcodec.evaluation.rigid import Matrix


@dataclass(frozen=True)
class Boxes:
    """N boxes at one moment.

    kinds: name of each object's kind; tracks: the same number for the same object in all frames
    middle: (N, 3) metres; axes: (N, 3, 3), the rows of each are its unit vectors along, to the left and up
    size: (N, 3) length, width and height in metres
    """

    kinds: tuple[str, ...]
    tracks: tuple[int, ...]
    middle: Matrix
    axes: Matrix
    size: Matrix

    def __len__(self) -> int:
        return len(self.kinds)

    def within(self, at: int, points: npt.NDArray[np.floating]) -> Matrix:
        """(N, 3) points as seen from the middle of box number `at`, along its axes."""
        inside: Matrix = (points - self.middle[at]) @ self.axes[at].T
        return inside


def upright(kinds: Sequence[str], tracks: Sequence[int], middle: Matrix, size: Matrix, yaw_rad: Matrix) -> Boxes:
    """Boxes that stand upright and are turned by `yaw_rad` (N,), counter-clockwise from x. The rest is as in Boxes."""
    c, s, none = np.cos(yaw_rad), np.sin(yaw_rad), np.zeros(len(yaw_rad))
    rows = [(c, s, none), (-s, c, none), (none, none, none + 1)]
    axes = np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
    return Boxes(tuple(kinds), tuple(tracks), middle.reshape(-1, 3), axes.reshape(-1, 3, 3), size.reshape(-1, 3))


def joined(parts: Sequence[Boxes]) -> Boxes:
    """All boxes of several groups as one."""
    if not parts:
        return upright((), (), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))
    return Boxes(
        tuple(kind for part in parts for kind in part.kinds),
        tuple(track for part in parts for track in part.tracks),
        *(np.concatenate([getattr(part, name) for part in parts]) for name in ("middle", "axes", "size")),
    )

"""MapPoints: the points of a map in whole steps, with what is known of each, and the frame of their coordinates.

A normal is kept as two numbers of five bits: the upper half of the sphere, unfolded to a square (hemi-octahedral
mapping; Cigolle et al., "A survey of efficient representations for independent unit vectors", 2014).

>>> up = np.array([[0.0, 0.0, 1.0]])
>>> bool(np.abs(normals_of(*packed_normals(up)) - up).max() < 0.06)
True
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from lidarcodec.evaluation.rigid import Matrix

NORMAL_BITS: Final = 5
COLUMNS: Final = {"normal_a": 1, "normal_b": 2, "count": 3, "first": 4, "last": 5}
"""Names of columns, and their numbers in a file."""
MOST_COUNT: Final = 255
Steps = npt.NDArray[np.int64]
Values = npt.NDArray[np.uint16]


@dataclass(frozen=True)
class MapFrame:
    """Where coordinates of a map are. zone: of UTM, 0 for a local frame; south: of the equator; origin: latitude,
    longitude and heading in degrees that `--origin` gave; (0, 0, 0) for a local frame"""

    zone: int = 0
    south: bool = False
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def name(self) -> str:
        """`local`, or the zone of UTM, as `UTM 32N`."""
        return f"UTM {self.zone}{'S' if self.south else 'N'}" if self.zone else "local"


LOCAL: Final = MapFrame()


@dataclass(frozen=True)
class MapPoints:
    """Points of a map.

    steps: (N, 3) int64, x, y, z in steps of `step_m`; columns: (N,) uint16 by name of COLUMNS
    path: (P, 3) float32, metres, where the sensor was, about one place a metre; empty if it was left out
    length_m: length of all drives
    """

    step_m: float
    steps: Steps
    columns: dict[str, Values] = field(default_factory=dict)
    path: npt.NDArray[np.float32] = field(default_factory=lambda: np.empty((0, 3), np.float32))
    length_m: float = 0.0
    frame: MapFrame = LOCAL

    def __len__(self) -> int:
        return len(self.steps)

    @property
    def xyz(self) -> Matrix:
        """(N, 3) float64, metres."""
        return self.steps.astype(np.float64) * np.float64(self.step_m)

    @property
    def normals(self) -> Matrix | None:
        """(N, 3) float64 unit vectors, z not negative; None if the map has none."""
        if "normal_a" not in self.columns:
            return None
        return normals_of(self.columns["normal_a"], self.columns["normal_b"])

    def taken(self, places: npt.NDArray[np.integer]) -> MapPoints:
        """The map of some of the points."""
        columns = {name: values[places] for name, values in self.columns.items()}
        return replace(self, steps=self.steps[places], columns=columns)

    def with_columns(self, *names: str) -> MapPoints:
        """The map with only these columns, of those that it has."""
        return replace(self, columns={name: self.columns[name] for name in names if name in self.columns})


def packed_normals(normals: Matrix) -> tuple[Values, Values]:
    """Two numbers of NORMAL_BITS bits for each of the unit vectors (N, 3). A vector and its opposite are the same."""
    upper = normals * np.where(normals[:, 2:] < 0, -1.0, 1.0)
    flat = upper[:, :2] / np.maximum(np.abs(upper).sum(axis=1, keepdims=True), 1e-9)
    most = (1 << NORMAL_BITS) - 1
    square = np.stack([flat[:, 0] + flat[:, 1], flat[:, 0] - flat[:, 1]])
    a, b = np.clip(np.floor((square + 1) * (most + 1) / 2), 0, most).astype(np.uint16)
    return a, b


def normals_of(a: Values, b: Values) -> Matrix:
    """(N, 3) float64 unit vectors of `packed_normals`, right to about three degrees."""
    a_flat, b_flat = ((values + 0.5) / (1 << (NORMAL_BITS - 1)) - 1 for values in (a, b))
    x, y = (a_flat + b_flat) / 2, (a_flat - b_flat) / 2
    found = np.stack([x, y, 1 - np.abs(x) - np.abs(y)], axis=1)
    unit: Matrix = found / np.linalg.norm(found, axis=1, keepdims=True)
    return unit

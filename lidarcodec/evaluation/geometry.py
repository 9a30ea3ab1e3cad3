"""How far apart two clouds are, as the papers on point clouds measure it: Chamfer, point-to-plane, D1 and D2.

With P the original cloud, Q the decoded one, and q(p) the point of Q that is nearest to p:

    Chamfer         max(CD(P, Q), CD(Q, P)),           CD(P, Q) = mean over p of |p - q(p)|
    point-to-plane  10 log10(3 r^2 / max(M(P, Q), M(Q, P))),  r = 59.70 m,
                    M(P, Q) = mean over p of ((p - q(p)) . n(p))^2,  M(Q, P) = mean over q of ((q - p(q)) . n(p(q)))^2
    D1              10 log10(3 r^2 / max(E(P, Q), E(Q, P))),  r = 30 m,  E(P, Q) = mean over p of |p - q(p)|^2
    D2              as D1, with errors along the normal of the point that was found, as MPEG's pc_error takes them

Chamfer and point-to-plane are those of OctSqueeze and MuSCLE, which RIDDLE reports with the same peak; the factor of 3
comes with pc_error's PSNR of geometry. 30 m is what MPEG's test conditions set for LiDAR (30,000 on a grid of 1 mm).

n is the normal of the original cloud: the direction in which the 12 nearest points (the point itself included) spread
least, turned towards the sensor. For D2 a decoded point takes the mean of the normals of the original points that it
is nearest to, or else that of its own nearest; two differences from pc_error remain: of several points at one and the
same distance one is taken, not their mean, and points that coincide are not merged first.

>>> errors = CloudErrors()
>>> grid = np.stack(np.meshgrid(np.arange(4.0), np.arange(4.0), [5.0]), axis=-1).reshape(-1, 3)
>>> errors.add(grid, grid + [0, 0, 0.25])
>>> {name: round(value, 2) for name, value in errors.result().items()}
{'chamfer_m': 0.25, 'point_to_plane_psnr_db': 52.33, 'd1_psnr_db': 46.35, 'd2_psnr_db': 46.35}
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]

PAPERS_PEAK_M: Final = 59.70
MPEG_PEAK_M: Final = 30.0
NEIGHBOURS: Final = 12
FIELDS: Final = ("chamfer_m", "point_to_plane_psnr_db", "d1_psnr_db", "d2_psnr_db")


def xyz_of(cloud: npt.NDArray[np.void]) -> Floats:
    """(N, 3) float64, the coordinates of a structured array of points."""
    return np.stack([cloud[name].astype(np.float64) for name in "xyz"], axis=1)


class Cloud:
    """Points with a search tree. points: (N, 3) float64, at least one."""

    def __init__(self, points: Floats) -> None:
        import small_gicp

        self.points = np.ascontiguousarray(points, np.float64)
        self._cloud = small_gicp.PointCloud(self.points)
        self._tree = small_gicp.KdTree(self._cloud)

    def nearest(self, points: Floats) -> Indices:
        """(M,) the place of the nearest of our points to each of `points`, (M, 3)."""
        found, _ = self._tree.batch_knn_search(np.ascontiguousarray(points, np.float64), 1)
        places: Indices = found[:, 0].astype(np.intp)
        return places

    def neighbours(self, points: Floats, count: int) -> Indices:
        """(M, count) the places of the nearest of our points to each of `points`, the nearest first."""
        found, _ = self._tree.batch_knn_search(np.ascontiguousarray(points, np.float64), count)
        places: Indices = found.astype(np.intp)
        return places

    def normals(self) -> Floats:
        """(N, 3) unit vectors towards the origin, where the sensor is; zeros where there are fewer than 5 points."""
        import small_gicp

        small_gicp.estimate_normals(self._cloud, self._tree, NEIGHBOURS)
        normals = np.asarray(self._cloud.normals(), np.float64)[:, :3]
        away = np.einsum("ij,ij->i", normals, self.points) > 0
        towards: Floats = np.where(away[:, None], -normals, normals)
        return towards


def carried_normals(normals: Floats, there: Indices, back: Indices) -> Floats:
    """(M, 3) the normals of decoded points: means over the original points that have them as their nearest.

    normals: (N, 3) of the original points; there: (N,) the nearest decoded point of each; back: (M,) the nearest
    original point of each decoded one, whose normal is used if it is the nearest of no decoded point.
    """
    counts = np.bincount(there, minlength=len(back))
    sums = np.stack([np.bincount(there, weights=normals[:, axis], minlength=len(back)) for axis in range(3)], axis=1)
    taken: Floats = np.where(counts[:, None] > 0, sums / np.maximum(counts, 1)[:, None], normals[back])
    return taken


def psnr_db(mse: float, peak_m: float) -> float | None:
    """PSNR of geometry, 10 log10(3 peak^2 / mse); None when there is no error (it would be infinite)."""
    return round(10 * math.log10(3 * peak_m**2 / mse), 4) if mse > 0 else None


def _mean_square(along: Floats) -> float:
    return float(np.mean(along * along))


def _dots(a: Floats, b: Floats) -> Floats:
    dots: Floats = np.einsum("ij,ij->i", a, b)
    return dots


@dataclass
class CloudErrors:
    """Adds up frames: the Chamfer distance is their mean, a PSNR that of their mean squared errors."""

    chamfer_m: list[float] = field(default_factory=list)
    plane: list[float] = field(default_factory=list)
    d1: list[float] = field(default_factory=list)
    d2: list[float] = field(default_factory=list)
    one_is_empty: bool = False

    def add(self, original: Floats, decoded: Floats) -> None:
        """Compare two clouds, (N, 3) and (M, 3) metres; about 0.3 s for 120,000 points."""
        if not len(original) or not len(decoded):
            self.one_is_empty |= len(original) != len(decoded)
            return
        before, after = Cloud(original), Cloud(decoded)
        there, back = after.nearest(original), before.nearest(decoded)
        off_there, off_back = original - decoded[there], decoded - original[back]
        far_there, far_back = np.linalg.norm(off_there, axis=1), np.linalg.norm(off_back, axis=1)
        normals = before.normals()
        of_decoded = carried_normals(normals, there, back)
        plane_back = _mean_square(_dots(off_back, normals[back]))
        self.chamfer_m.append(max(float(far_there.mean()), float(far_back.mean())))
        self.d1.append(max(_mean_square(far_there), _mean_square(far_back)))
        self.plane.append(max(_mean_square(_dots(off_there, normals)), plane_back))
        self.d2.append(max(_mean_square(_dots(off_there, of_decoded[there])), plane_back))

    def take(self, other: CloudErrors) -> None:
        """Count the last frame of another one here, too."""
        for name in ("chamfer_m", "d1", "plane", "d2"):
            getattr(self, name).extend(getattr(other, name)[-1:])
        self.one_is_empty |= other.one_is_empty

    def result(self) -> dict[str, Any]:
        """`chamfer_m`, `point_to_plane_psnr_db`, `d1_psnr_db`, `d2_psnr_db`.

        All None when nothing could be compared, or when a cloud of some frame was empty and the other was not.
        """
        if not self.d1 or self.one_is_empty:
            return dict.fromkeys(FIELDS)
        return {
            "chamfer_m": round(float(np.mean(self.chamfer_m)), 7),
            "point_to_plane_psnr_db": psnr_db(float(np.mean(self.plane)), PAPERS_PEAK_M),
            "d1_psnr_db": psnr_db(float(np.mean(self.d1)), MPEG_PEAK_M),
            "d2_psnr_db": psnr_db(float(np.mean(self.d2)), MPEG_PEAK_M),
        }

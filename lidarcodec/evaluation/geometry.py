"""Distances of two clouds, as in papers on point clouds: Chamfer, point-to-plane, D1 and D2.

With P the original cloud, Q the decoded one, and q(p) the point of Q that is nearest to p:

    Chamfer         max(CD(P, Q), CD(Q, P)),           CD(P, Q) = mean over p of |p - q(p)|
    point-to-plane  10 log10(3 r^2 / max(M(P, Q), M(Q, P))),  r = 59.70 m,
                    M(P, Q) = mean over p of ((p - q(p)) . n(p))^2,  M(Q, P) = mean over q of ((q - p(q)) . n(p(q)))^2
    D1              10 log10(3 r^2 / max(E(P, Q), E(Q, P))),  r = 30 m,  E(P, Q) = mean over p of |p - q(p)|^2
    D2              as D1, with errors along the normal of the nearest point, as in MPEG's pc_error

Chamfer and point-to-plane are defined as in OctSqueeze and MuSCLE; RIDDLE reports them with the same peak. The factor 3
comes from pc_error's PSNR of geometry. MPEG's test conditions set 30 m for LiDAR (30,000 on a grid of 1 mm).

n is the normal of the original cloud: the direction in which the 12 nearest points (including the point itself) spread
least, turned towards the sensor. D2 needs the normal of a decoded point q: it is the mean normal of the original points
whose nearest decoded point is q. Without such points it is the normal of the original point nearest to q. There are two
differences from pc_error: of several points at the same distance we use one, not their mean, and we do not merge points
at the same place.

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
        """(M,) indices: for each of `points` (M, 3), the nearest point of this cloud."""
        found, _ = self._tree.batch_knn_search(np.ascontiguousarray(points, np.float64), 1)
        places: Indices = found[:, 0].astype(np.intp)
        return places

    def neighbours(self, points: Floats, count: int) -> Indices:
        """(M, count) indices: for each of `points`, the nearest points of this cloud, nearest first."""
        found, _ = self._tree.batch_knn_search(np.ascontiguousarray(points, np.float64), count)
        places: Indices = found.astype(np.intp)
        return places

    def normals(self) -> Floats:
        """(N, 3) unit vectors towards the sensor at the origin; zeros if the cloud has fewer than 5 points."""
        import small_gicp

        small_gicp.estimate_normals(self._cloud, self._tree, NEIGHBOURS)
        normals = np.asarray(self._cloud.normals(), np.float64)[:, :3]
        away = np.einsum("ij,ij->i", normals, self.points) > 0
        towards: Floats = np.where(away[:, None], -normals, normals)
        return towards


def carried_normals(normals: Floats, there: Indices, back: Indices) -> Floats:
    """(M, 3) the normals of decoded points: means over the original points with this nearest decoded point.

    normals: (N, 3) normals of the original points; there: (N,) the nearest decoded point of each original point;
    back: (M,) the nearest original point of each decoded point; its normal is used if the mean has no points
    """
    counts = np.bincount(there, minlength=len(back))
    sums = np.stack([np.bincount(there, weights=normals[:, axis], minlength=len(back)) for axis in range(3)], axis=1)
    taken: Floats = np.where(counts[:, None] > 0, sums / np.maximum(counts, 1)[:, None], normals[back])
    return taken


def psnr_db(mse: float, peak_m: float) -> float | None:
    """PSNR of geometry, 10 log10(3 peak^2 / mse); None if there is no error (it would be infinite)."""
    return round(10 * math.log10(3 * peak_m**2 / mse), 4) if mse > 0 else None


def _mean_square(along: Floats) -> float:
    return float(np.mean(along * along))


def _dots(a: Floats, b: Floats) -> Floats:
    dots: Floats = np.einsum("ij,ij->i", a, b)
    return dots


@dataclass
class CloudErrors:
    """Errors over frames. The Chamfer distance is a mean over frames; a PSNR uses the mean of the squared errors."""

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
        """Also count the last frame of `other` here."""
        for name in ("chamfer_m", "d1", "plane", "d2"):
            getattr(self, name).extend(getattr(other, name)[-1:])
        self.one_is_empty |= other.one_is_empty

    def result(self) -> dict[str, Any]:
        """`chamfer_m`, `point_to_plane_psnr_db`, `d1_psnr_db`, `d2_psnr_db`.

        All are None if nothing could be compared, or if in a frame only one of the two clouds was empty.
        """
        if not self.d1 or self.one_is_empty:
            return dict.fromkeys(FIELDS)
        return {
            "chamfer_m": round(float(np.mean(self.chamfer_m)), 7),
            "point_to_plane_psnr_db": psnr_db(float(np.mean(self.plane)), PAPERS_PEAK_M),
            "d1_psnr_db": psnr_db(float(np.mean(self.d1)), MPEG_PEAK_M),
            "d2_psnr_db": psnr_db(float(np.mean(self.d2)), MPEG_PEAK_M),
        }

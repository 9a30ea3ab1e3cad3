"""The parts of a frame: which returns lie on the ground, and which of the others belong together.

>>> from lidarcodec.evaluation.localisation.drive import read_drive
>>> parts = segments_of(read_drive("sim:street?frames=3").frames[0])
>>> bool(0.2 < parts.ground.mean() < 0.9), int(parts.clusters.max()) > 10
(True, True)
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from lidarcodec import _native
from lidarcodec.errors import SourceError
from lidarcodec.filling import measured_only
from lidarcodec.frame import Frame


@dataclass(frozen=True)
class Segments:
    """The N measured returns of a frame.

    points: (N, 3) float32, metres in the sensor's frame; cells: (N,) place of each return in the image, column by
    column
    ground: (N,) bool; clusters: (N,) int32, number of the object that a return belongs to, -1 on the ground
    """

    points: npt.NDArray[np.float32]
    cells: npt.NDArray[np.intp]
    ground: npt.NDArray[np.bool_]
    clusters: npt.NDArray[np.int32]

    @cached_property
    def sizes(self) -> npt.NDArray[np.intp]:
        """(C,) number of returns of each cluster."""
        return np.bincount(self.clusters[self.clusters >= 0], minlength=int(self.clusters.max(initial=-1)) + 1)


def segments_of(frame: Frame) -> Segments:
    """Ground and clusters of a frame, without the returns that a receiver interpolated. Cost: 25 ms for a turn of an
    HDL-64E.

    Ground: after Himmelsbach et al. 2010; clusters: after Bogoslavskyi and Stachniss 2016. See native/src/segments.
    Raises SourceError for a frame without a range image.
    """
    measured = measured_only(frame)
    cells = np.flatnonzero(measured.valid.T)
    cloud = measured.cloud()
    if frame.sensor.is_cloud or len(cells) != len(cloud):
        raise SourceError("evaluate detection needs packets: it cannot use point clouds, which have no beams")
    points = np.ascontiguousarray(np.stack([cloud[name] for name in "xyz"], axis=-1), np.float32)
    ground = _native.ground_points(points)
    clusters = _native.cluster_points(points, cloud["ring"].astype(np.uint16), ground)
    return Segments(points, cells, ground.view(np.bool_), clusters)


Surfaces = npt.NDArray[np.int8]
"""(C,) of each cell of an image: 0 = no return, 1 = a return above the ground, 2 = one on the ground."""


def surfaces_of(parts: Segments) -> Surfaces:
    """What each cell of the frame's image holds; cells behind the last return are left out."""
    surfaces = np.zeros(parts.cells.max(initial=-1) + 1, np.int8)
    surfaces[parts.cells] = 1 + parts.ground
    return surfaces


def ground_overlap(original: Surfaces, decoded: Segments) -> tuple[int, int]:
    """How many returns lie on the ground in both frames, and how many in at least one of them. Only returns that both
    have are counted."""
    known = decoded.cells < len(original)
    there = original[decoded.cells[known]]
    one, other = there[there > 0] == 2, decoded.ground[known][there > 0]
    return int(np.count_nonzero(one & other)), int(np.count_nonzero(one | other))

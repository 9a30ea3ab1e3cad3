"""Choices of returns that exist only for comparison; no vehicle can make them.

harris         3D Harris                           } baselines of the paper; not learned, from one scan
iss            intrinsic shape signatures          } oracle the highest true counts
oracle-spread  `voxel` among three times as many returns with the highest true counts
oracle-static  `voxel` among returns that at least four scans saw, so without moving objects

The oracles know the whole drive: they are an upper limit for methods that count observations. The encoder applies the
reducers in `lidarcodec.reduction` itself.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from lidarcodec.evaluation.geometry import xyz_of
from lidarcodec.evaluation.localisation.drive import in_reach
from lidarcodec.evaluation.localisation.keypoints import Places, harris, iss
from lidarcodec.evaluation.rigid import Matrix
from lidarcodec.frame import Frame
from lidarcodec.reduction.base import Budget
from lidarcodec.reduction.voxel import Voxel

Counts = Callable[[], npt.NDArray[np.int32]]
"""A function that computes the true counts of the points. It is called only if they are needed."""
OVER: Final = 3
STATIC: Final = 4


class Choice(NamedTuple):
    """places: function of (points, number, counts) that gives the chosen points; spread: whether `voxel` then chooses
    among them"""

    places: Callable[[Matrix, int, Counts], Places]
    spread: bool = False


def _highest(counts: npt.NDArray[np.int32], count: int) -> Places:
    """The points with the highest counts; ties are broken at random."""
    lots = np.random.default_rng(len(counts)).random(len(counts))
    return np.lexsort((lots, -counts))[:count]


CHOICES: Final[dict[str, Choice]] = {
    "harris": Choice(lambda points, count, _: harris(points, count)),
    "iss": Choice(lambda points, count, _: iss(points, count)),
    "oracle": Choice(lambda _, count, counts: _highest(counts(), count)),
    "oracle-spread": Choice(lambda _, count, counts: _highest(counts(), OVER * count), spread=True),
    "oracle-static": Choice(lambda _, __, counts: np.flatnonzero(counts() >= STATIC), spread=True),
}


def kept(frame: Frame, name: str, count: int, counts: Counts) -> Frame:
    """The frame with `keep` set by a choice among the returns that are neither on the car itself nor too far away.

    counts: gives the true counts of these returns, column by column
    """
    points = xyz_of(frame.cloud())
    usable = in_reach(points)
    places = np.flatnonzero(frame.valid.T)[usable]
    if len(places) > count:
        places = places[CHOICES[name].places(points[usable], count, counts)]
    keep = np.zeros(frame.range.T.shape, np.bool_)
    keep.ravel()[places] = True
    chosen = frame.with_(keep=np.ascontiguousarray(keep.T))
    return Voxel(Budget(points=count)).reduce(chosen) if CHOICES[name].spread else chosen

"""Which returns of a frame are sent, for comparison only: choices that no vehicle makes.

    harris         Harris in three dimensions          } of the paper; learnt nothing, know one scan
    iss            intrinsic shape signatures          }
    oracle         the highest true counts
    oracle-spread  `voxel` among the three times as many of the highest true counts
    oracle-static  `voxel` among what at least four scans saw: what moves is gone

The oracles know the whole drive; they are the most that counting could give. Reducers of the product have their names
in `lidarcodec.reduction`, and are applied by the encoder itself.
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
"""Gives the true counts of the points in question, when they are asked for."""
OVER: Final = 3
STATIC: Final = 4


class Choice(NamedTuple):
    """places: those of (points, a number, their counts); spread: whether `voxel` has the last word among them"""

    places: Callable[[Matrix, int, Counts], Places]
    spread: bool = False


def _highest(counts: npt.NDArray[np.int32], count: int) -> Places:
    """Ties are broken by lot."""
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
    """The frame with `keep` set by a choice among the returns that are neither the car's own nor too far.

    counts: gives the true counts of those returns, column by column
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

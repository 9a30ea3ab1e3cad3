"""Scores over all frames of a drive, and how far those of decoded frames differ from those of the original ones.

Errors are one standard deviation by bootstrap. Objects are drawn with all their frames, since what happens to an object
in one frame happens to it in the next one too; for the ground, frames are drawn.

>>> found = np.array([1.0, 1.0, 0.0, 1.0])
>>> mean_and_error(found, np.array([1, 1, 2, 3]), seed=1)[0]
0.75
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from lidarcodec.evaluation.detection.boxes import Boxes
from lidarcodec.evaluation.detection.objects import Objects

BANDS_M: Final = ((0.0, 15.0), (15.0, 30.0), (30.0, 50.0), (50.0, 80.0))
FEWEST_RETURNS: Final = 20
"""Objects with fewer returns in the original frame are not counted."""
DRAWS: Final = 1000
Numbers = npt.NDArray[np.float64]
Score = dict[str, Any]


def mean_and_error(values: Numbers, tracks: npt.NDArray[Any], seed: int) -> tuple[float | None, float | None]:
    """Mean of the values that are numbers, and its standard error by bootstrap over tracks; None where there are none,
    or fewer than two tracks.

    values, tracks: (N,) each, of the same objects
    """
    there = np.isfinite(values)
    if not np.any(there):
        return None, None
    mean = float(values[there].mean())
    names, place = np.unique(tracks[there], return_inverse=True)
    if len(names) < 2:
        return mean, None
    sums, counts = np.bincount(place, values[there]), np.bincount(place)
    drawn = np.random.default_rng(seed).multinomial(len(names), np.full(len(names), 1 / len(names)), DRAWS)
    return mean, float(np.std(drawn @ sums / (drawn @ counts)))


@dataclass
class Tally:
    """What was measured in each frame, one row for each object that is counted.

    kinds, tracks, distances_m: of the objects; returns, found, size_m: what is left of them; label_m: (N, 3) their true
    size; ground: returns on the ground in both frames, and in at least one, for each frame
    """

    kinds: list[str] = field(default_factory=list)
    tracks: list[int] = field(default_factory=list)
    distances_m: list[float] = field(default_factory=list)
    returns: list[float] = field(default_factory=list)
    found: list[float] = field(default_factory=list)
    size_m: list[Numbers] = field(default_factory=list)
    label_m: list[Numbers] = field(default_factory=list)
    ground: list[tuple[int, int]] = field(default_factory=list)

    def add(self, boxes: Boxes, objects: Objects, counted: npt.NDArray[np.bool_], ground: tuple[int, int]) -> None:
        """Add a frame. counted: (N,) which of its boxes are counted"""
        for at in np.flatnonzero(counted):
            self.kinds.append(boxes.kinds[at])
            self.tracks.append(boxes.tracks[at])
            self.distances_m.append(float(np.linalg.norm(boxes.middle[at, :2])))
            self.returns.append(float(objects.returns[at]))
            self.found.append(float(objects.found[at]))
            self.size_m.append(objects.size[at] if objects.found[at] else np.full(3, np.nan))
            self.label_m.append(boxes.size[at])
        self.ground.append(ground)

    @property
    def size_error_m(self) -> Numbers:
        """(N,) mean difference between the size of the cluster and that of the label; NaN of what was not found."""
        off: Numbers = np.abs(np.reshape(self.size_m, (-1, 3)) - np.reshape(self.label_m, (-1, 3))).mean(axis=1)
        return off


def scores(tally: Tally, original: Tally, seed: int) -> Score:
    """Scores of decoded frames and their differences from those of the original frames, which have the same objects."""
    every = np.ones(len(tally.tracks), np.bool_)
    kinds, distances = np.array(tally.kinds, object), np.array(tally.distances_m)
    common, either = np.reshape(tally.ground, (-1, 2)).sum(axis=0).tolist()
    return {
        **_objects(tally, original, every, seed),
        "ground_iou": common / either if either else None,
        "ground_iou_error": _ground_error(tally.ground, seed),
        "kinds": {kind: _objects(tally, original, kinds == kind, seed) for kind in sorted(set(tally.kinds))},
        "distances": {
            f"{low:.0f}-{high:.0f}": _objects(tally, original, (distances >= low) & (distances < high), seed)
            for low, high in BANDS_M
            if np.any((distances >= low) & (distances < high))
        },
    }


def _objects(tally: Tally, original: Tally, chosen: npt.NDArray[np.bool_], seed: int) -> Score:
    tracks = np.array(tally.tracks, np.int64)[chosen]
    found, before = (np.array(one.found)[chosen] for one in (tally, original))
    returns = (np.array(tally.returns) / np.maximum(original.returns, 1))[chosen]
    size, size_before = (one.size_error_m[chosen] for one in (tally, original))
    score: Score = {"objects": len(found), "tracks": len(np.unique(tracks))}
    for name, values in (("found", found), ("returns", returns), ("size_error_m", size)):
        score[name], score[f"{name}_error"] = mean_and_error(values, tracks, seed)
    for name, apart in (("found", found - before), ("size_error", size - size_before)):
        score[f"{name}_difference"], score[f"{name}_difference_error"] = mean_and_error(apart, tracks, seed)
    return score


def _ground_error(ground: Sequence[tuple[int, int]], seed: int) -> float | None:
    if len(ground) < 2:
        return None
    sums = np.reshape(ground, (-1, 2)).astype(np.float64)
    drawn = np.random.default_rng(seed).multinomial(len(sums), np.full(len(sums), 1 / len(sums)), DRAWS) @ sums
    return float(np.std(drawn[:, 0] / np.maximum(drawn[:, 1], 1)))

"""Average precision of what the detector finds, and how far that of decoded frames is from that of the original ones.

An object counts as found by the best box of its kind that overlaps it by at least `ENOUGH`, seen from above; boxes are
asked in the order of their scores. Average precision is the mean over 40 recalls of the best precision at that recall
or a higher one (Simonelli et al. 2019), as KITTI has it. Errors are one standard deviation by bootstrap over runs of
ten frames, because what happens to an object happens to it in the next frame too.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from lidarcodec.evaluation.detection.boxes import Boxes
from lidarcodec.evaluation.detection.detector.network import KINDS
from lidarcodec.evaluation.detection.detector.objects import Found, turned
from lidarcodec.evaluation.detection.detector.overlap import overlaps
from lidarcodec.evaluation.detection.detector.view import counted

KIND_OF: Final = {"car": "vehicle", "van": "vehicle", "cyclist": "cyclist", "pedestrian": "pedestrian"}
"""What each label is for the detector. Labels that are not here are neither to be found nor to be left out."""
ENOUGH: Final = {"vehicle": 0.5, "cyclist": 0.25, "pedestrian": 0.25}
RECALLS: Final = 40
RUN: Final = 10
"""Frames that are drawn together."""
DRAWS: Final = 1000
Floats = npt.NDArray[np.float64]


@dataclass
class Hits:
    """What was found of one kind.

    scores, right, runs: of each box, whether it is an object, and its run of frames; objects: in each run
    """

    scores: list[float] = field(default_factory=list)
    right: list[bool] = field(default_factory=list)
    runs: list[int] = field(default_factory=list)
    objects: dict[int, int] = field(default_factory=dict)

    def average_precision(self, weights: Floats) -> Floats:
        """(D,) for weights (D, runs) of the runs; NaN without an object."""
        order = np.argsort(-np.array(self.scores), kind="stable")
        right, runs = np.array(self.right, np.bool_)[order], np.array(self.runs, np.intp)[order]
        of_run = np.zeros(weights.shape[1])
        of_run[list(self.objects)] = list(self.objects.values())
        wanted = weights @ of_run
        each = weights[:, runs]
        true = np.cumsum(each * right, axis=1)
        precision = true / np.maximum(np.cumsum(each, axis=1), 1e-9)
        best = np.maximum.accumulate(precision[:, ::-1], axis=1)[:, ::-1]
        recall = true / np.maximum(wanted, 1e-9)[:, None]
        total = np.zeros(len(weights))
        for level in np.arange(1, RECALLS + 1) / RECALLS:
            reached = recall >= level - 1e-9
            if reached.shape[1]:
                at = reached.argmax(axis=1)
                total += np.where(reached.any(axis=1), best[np.arange(len(best)), at], 0.0)
        return np.where(wanted > 0, total / RECALLS, np.nan)


class Precision:
    """What was found of each kind in the frames of a drive, or of several drives."""

    def __init__(self) -> None:
        self.hits = {kind: Hits() for kind in KINDS}
        self.runs = 0

    def add(self, frame: int, found: Found, boxes: Boxes, fit: npt.NDArray[np.bool_], sectors: int) -> None:
        """Add a frame. frame: its number, of frames that are added in order; fit: (N,) which boxes have enough returns
        to be found; sectors: that were looked at"""
        run = frame // RUN
        self.runs = max(self.runs, run + 1)
        labels = _seen_from_above(boxes)
        visible = _within(boxes.middle, sectors)
        for number, kind in enumerate(KINDS):
            own = np.array([KIND_OF.get(name) == kind for name in boxes.kinds], np.bool_)
            wanted = own & fit & visible
            hits = self.hits[kind]
            hits.objects[run] = hits.objects.get(run, 0) + int(wanted.sum())
            chosen = found.kind == number
            for score, right in _matched(
                found.score[chosen], overlaps(found.boxes[chosen], labels), wanted, ENOUGH[kind]
            ):
                hits.scores.append(score)
                hits.right.append(right)
                hits.runs.append(run)

    def extend(self, other: Precision) -> None:
        """Add the frames of another drive."""
        for kind, hits in other.hits.items():
            own = self.hits[kind]
            own.scores += hits.scores
            own.right += hits.right
            own.runs += [run + self.runs for run in hits.runs]
            own.objects |= {run + self.runs: count for run, count in hits.objects.items()}
        self.runs += other.runs


def precisions(decoded: Precision, original: Precision, seed: int) -> dict[str, dict[str, Any]]:
    """By kind: average precision, its difference from that of the original frames, and their standard errors; only
    kinds that the labels have."""
    runs = original.runs
    drawn = np.random.default_rng(seed).multinomial(runs, np.full(runs, 1 / runs), DRAWS) if runs else np.zeros((0, 0))
    weights = np.concatenate([np.ones((1, runs)), drawn])
    scores: dict[str, dict[str, Any]] = {}
    for kind in KINDS:
        objects = sum(original.hits[kind].objects.values())
        if not objects:
            continue
        found, before = (one.hits[kind].average_precision(weights) for one in (decoded, original))
        scores[kind] = {"objects": objects, "ap": float(found[0]), "ap_error": _spread(found[1:], runs)} | {
            "ap_difference": float(found[0] - before[0]), "ap_difference_error": _spread((found - before)[1:], runs)
        }  # fmt: skip
    return scores


def _spread(values: Floats, runs: int) -> float | None:
    return float(np.nanstd(values)) if runs > 1 else None


def _matched(scores: Floats, overlap: Floats, wanted: npt.NDArray[np.bool_], enough: float) -> list[tuple[float, bool]]:
    """Score of each box, and whether it is an object that no better box has. Boxes on what is not wanted are left
    out."""
    free, rows = wanted.copy(), list[tuple[float, bool]]()
    for score, row in zip(scores.tolist(), overlap, strict=True):
        own = np.where(free, row, 0.0)
        if len(own) and own.max() >= enough:
            free[int(own.argmax())] = False
            rows.append((score, True))
        elif not np.any(row[~wanted] >= enough / 2):
            rows.append((score, False))
    return rows


def _seen_from_above(boxes: Boxes) -> Floats:
    """(N, 5) x, y, length, width and angle."""
    angle = np.arctan2(boxes.axes[:, 0, 1], boxes.axes[:, 0, 0])
    return np.concatenate([boxes.middle[:, :2], boxes.size[:, :2], angle[:, None]], axis=1)


def _within(middle: Floats, sectors: int) -> npt.NDArray[np.bool_]:
    found = np.zeros(len(middle), np.bool_)
    for number in range(sectors):
        found |= counted(np.asarray(turned(middle, -2 * np.pi * number / sectors), np.float64))
    return found

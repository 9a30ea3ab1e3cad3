"""Agreement of scores and classes with labels: the values in the tables of docs/reduction.md.

precision at the true share   share of high returns among the n returns with the highest scores; n returns are high
chance                        the same for random scores of returns that are not ground
IoU                           for each class; accuracy: over all returns

>>> report = Agreement()
>>> report.add(np.array([0.9, 0.8, 0.1, 0.2]), np.array([2, 1, 1, 3]), np.array([2, 1, 2, 3]))
>>> report.result()["precision"], report.result()["iou"]["ground"]
(0.5, 1.0)
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from lidarcodec.training.labels import GROUND, HIGH, LOW, NAMES

CLASSES: Final = (LOW, HIGH, GROUND)


@dataclass
class Agreement:
    """Results over frames. Precision is a mean over frames, all else is over all returns."""

    precisions: list[float] = field(default_factory=list)
    chances: list[float] = field(default_factory=list)
    ranks: list[float] = field(default_factory=list)
    seldom: list[tuple[float, float]] = field(default_factory=list)
    confusion: npt.NDArray[np.int64] = field(default_factory=lambda: np.zeros((4, 4), np.int64))

    def add(
        self, high: npt.NDArray[Any], found: npt.NDArray[Any], labels: npt.NDArray[Any],
        counts: npt.NDArray[Any] | None = None, rank: npt.NDArray[Any] | None = None,
    ) -> None:  # fmt: skip
        """Add a frame's returns, (N,) each: scores for high, predicted labels, true labels. With counts also the rank
        correlation (Spearman) of `rank` and counts, over returns that are not ground."""
        self.confusion += np.bincount(labels.astype(np.int64) * 4 + found, minlength=16).reshape(4, 4)
        true, beside = labels == HIGH, labels != GROUND
        wanted = int(true.sum())
        if wanted and beside.sum() > wanted:
            self.precisions.append(float(true[_highest(high, wanted)].mean()))
            self.chances.append(wanted / int(beside.sum()))
        if counts is not None and rank is not None and beside.sum() > 2:
            self.ranks.append(_spearman(counts[beside], rank[beside]))

    def add_seldom(self, seldom: npt.NDArray[Any], truth: npt.NDArray[np.bool_]) -> None:
        """Add scores for rarely seen returns, and whether they were rarely seen, for returns where this is known."""
        if 0 < truth.sum() < len(truth):
            self.seldom.append((float(truth[_highest(seldom, int(truth.sum()))].mean()), float(truth.mean())))

    def result(self) -> dict[str, Any]:
        """`frames precision chance iou{} accuracy rank_correlation seldom_precision seldom_chance`; None without
        frames.
        """
        total = max(int(self.confusion.sum()), 1)
        iou = {}
        for label in CLASSES:
            both = self.confusion[label, label]
            either = self.confusion[label].sum() + self.confusion[:, label].sum() - both
            iou[NAMES[label]] = round(float(both / either), 4) if either else None
        seldom = np.mean(self.seldom, axis=0) if self.seldom else (None, None)
        return {
            "frames": len(self.precisions),
            "precision": _mean(self.precisions),
            "chance": _mean(self.chances),
            "iou": iou,
            "accuracy": round(float(np.trace(self.confusion) / total), 4),
            "rank_correlation": _mean(self.ranks),
            "seldom_precision": None if seldom[0] is None else round(float(seldom[0]), 4),
            "seldom_chance": None if seldom[1] is None else round(float(seldom[1]), 4),
        }


def _mean(values: list[float]) -> float | None:
    return round(float(np.mean(values)), 4) if values else None


def _highest(scores: npt.NDArray[Any], count: int) -> npt.NDArray[np.intp]:
    return np.argpartition(-scores.astype(np.float64), count - 1)[:count]


def _spearman(a: npt.NDArray[Any], b: npt.NDArray[Any]) -> float:
    one, two = _ranks(a), _ranks(b)
    spread = float(one.std() * two.std())
    return float(((one - one.mean()) * (two - two.mean())).mean() / spread) if spread > 0 else 0.0


def _ranks(values: npt.NDArray[Any]) -> npt.NDArray[np.float64]:
    """Ranks; equal values have the mean of their ranks."""
    _, place, many = np.unique(values, return_inverse=True, return_counts=True)
    ends = np.cumsum(many)
    ranks: npt.NDArray[np.float64] = (ends - (many - 1) / 2)[place].astype(np.float64)
    return ranks

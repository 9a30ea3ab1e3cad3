"""What the detector finds in a frame: boxes with a score, from the network's answers."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from lidarcodec.evaluation.detection.detector.network import KINDS, Network
from lidarcodec.evaluation.detection.detector.overlap import overlaps
from lidarcodec.evaluation.detection.detector.view import DEPTH_M, OUT_CELLS, OUT_M, Floats, counted, seen

LEAST: Final = 0.05
"""Objects with a lower score are left out."""
MOST: Final = 100
"""Objects of each kind in a view."""
SAME: Final = 0.1
"""Overlap above which two boxes of one kind are the same object: the one with the lower score goes."""
LARGEST: Final = 3.5
"""Natural logarithm of the largest size in metres that is believed."""


class Found(NamedTuple):
    """kind: (N,) index into KINDS; score: (N,) 0 to 1, the largest first; boxes: (N, 5) x, y, length, width in metres,
    and the angle in radians, of which half a turn means nothing"""

    kind: npt.NDArray[np.int64]
    score: npt.NDArray[np.float64]
    boxes: npt.NDArray[np.float64]


NONE: Final = Found(np.zeros(0, np.int64), np.zeros(0), np.zeros((0, 5)))


def found_in(
    network: Network, points: npt.NDArray[np.floating], intensity: npt.NDArray[np.uint8], sectors: int
) -> Found:
    """The objects in a cloud (N, 3) in the frame of the sensor. intensity: (N,); sectors: 1 looks ahead only, 5 around

    Cost: 0.1 s of a core for each sector.
    """
    parts = []
    for number in range(sectors):
        turn = 2 * np.pi * number / sectors
        one = _decoded(network(seen(turned(points, -turn), intensity)))
        boxes = np.concatenate([turned(one.boxes[:, :2], turn), one.boxes[:, 2:4], one.boxes[:, 4:] + turn], axis=1)
        parts.append(one._replace(boxes=boxes))
    whole = Found(*(np.concatenate(part) for part in zip(*parts, strict=True)))
    return _single(whole)


def turned(points: npt.NDArray[np.floating], angle: float) -> npt.NDArray[np.floating]:
    """Points (N, 2) or (N, 3) turned about the vertical through the sensor, counter-clockwise."""
    if not angle:
        return points
    c, s = np.cos(angle), np.sin(angle)
    whole = points.copy()
    whole[:, 0], whole[:, 1] = c * points[:, 0] - s * points[:, 1], s * points[:, 0] + c * points[:, 1]
    return whole


def _decoded(answer: Floats) -> Found:
    """The peaks of a view's answer: cells above all of their eight neighbours."""
    chance = 1 / (1 + np.exp(-np.clip(answer[: len(KINDS)].astype(np.float64), -50, 50)))
    around = np.pad(chance, ((0, 0), (1, 1), (1, 1)))
    sides = [around[:, down : down + OUT_CELLS, right : right + OUT_CELLS] for down in range(3) for right in range(3)]
    peaks = (chance >= np.max(sides, axis=0)) & (chance > LEAST)
    kind, at_x, at_y = np.nonzero(peaks)
    score = chance[kind, at_x, at_y]
    best = np.argsort(-score, kind="stable")[: MOST * len(KINDS)]
    kind, at_x, at_y, score = kind[best], at_x[best], at_y[best], score[best]
    values = answer[len(KINDS) :, at_x, at_y].astype(np.float64)
    x = (at_x + 0.5 + np.clip(values[0], -3, 3)) * OUT_M
    y = (at_y + 0.5 + np.clip(values[1], -3, 3)) * OUT_M - DEPTH_M / 2
    size = np.exp(np.clip(values[3:5], -LARGEST, LARGEST))
    angle = np.arctan2(values[6], values[7]) / 2
    inside = counted(np.stack([x, y], axis=-1))
    boxes = np.stack([x, y, *size, angle], axis=-1)
    return Found(kind[inside], score[inside], boxes[inside])


def _single(found: Found) -> Found:
    """Without boxes that overlap a better one of their kind."""
    order = np.argsort(-found.score, kind="stable")
    kind, score, boxes = found.kind[order], found.score[order], found.boxes[order]
    same = (overlaps(boxes, boxes) > SAME) & (kind[:, None] == kind)
    kept = np.ones(len(kind), np.bool_)
    for at in range(len(kind)):
        if kept[at]:
            kept[at + 1 :] &= ~same[at, at + 1 :]
    return Found(kind[kept], score[kept], boxes[kept])

"""How much two rectangles on the ground overlap: the intersection over union of boxes seen from above.

>>> car = np.array([[10.0, 0.0, 4.0, 2.0, 0.0]])
>>> overlaps(car, np.array([[11.0, 0.0, 4.0, 2.0, np.pi], [20.0, 0.0, 4.0, 2.0, 0.0]])).round(6).tolist()
[[0.6, 0.0]]
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

CORNERS: Final = np.array([(0.5, 0.5), (-0.5, 0.5), (-0.5, -0.5), (0.5, -0.5)])
TINY: Final = 1e-9
Floats = npt.NDArray[np.float64]


def overlaps(first: Floats, second: Floats) -> Floats:
    """(N, M) intersection over union of rectangles (N, 5) and (M, 5): x, y, length, width in metres, and the angle of
    the length in radians, counter-clockwise from x."""
    found = np.zeros((len(first), len(second)))
    reach = (np.hypot(*first[:, 2:4].T)[:, None] + np.hypot(*second[:, 2:4].T)) / 2
    apart = np.hypot(first[:, None, 0] - second[:, 0], first[:, None, 1] - second[:, 1])
    one, other = np.nonzero(apart < reach)
    if len(one):
        common = _common(first[one], second[other])
        areas = first[one, 2] * first[one, 3] + second[other, 2] * second[other, 3]
        found[one, other] = common / np.maximum(areas - common, TINY)
    return found


def _common(first: Floats, second: Floats) -> Floats:
    """(P,) area that pairs of rectangles (P, 5) share: a convex polygon, whose corners are those of one rectangle in
    the other, and the crossings of their sides."""
    a, b = _corners(first), _corners(second)
    crossings, crossed = _crossings(a, b)
    points = np.concatenate([a, b, crossings], axis=1)
    there = np.concatenate([_within(a, second), _within(b, first), crossed], axis=1)
    count = there.sum(axis=1)
    middle = (points * there[:, :, None]).sum(axis=1) / np.maximum(count, 1)[:, None]
    away = points - middle[:, None]
    angle = np.where(there, np.arctan2(away[:, :, 1], away[:, :, 0]), np.inf)
    order = np.argsort(angle, axis=1)
    away = np.take_along_axis(away, order[:, :, None], axis=1)
    last = np.arange(points.shape[1]) >= count[:, None]
    away = np.where(last[:, :, None], away[:, :1], away)  # what is not there repeats the first corner: no area
    after = np.roll(away, -1, axis=1)
    area: Floats = np.abs((away[:, :, 0] * after[:, :, 1] - away[:, :, 1] * after[:, :, 0]).sum(axis=1)) / 2
    return np.where(count > 2, area, 0.0)


def _corners(boxes: Floats) -> Floats:
    c, s = np.cos(boxes[:, 4]), np.sin(boxes[:, 4])
    turn = np.stack([np.stack([c, s], -1), np.stack([-s, c], -1)], -2)
    found: Floats = (CORNERS * boxes[:, None, 2:4]) @ turn + boxes[:, None, :2]
    return found


def _within(points: Floats, boxes: Floats) -> npt.NDArray[np.bool_]:
    c, s = np.cos(boxes[:, 4])[:, None], np.sin(boxes[:, 4])[:, None]
    x, y = np.moveaxis(points - boxes[:, None, :2], -1, 0)
    along, across = np.abs(c * x + s * y), np.abs(c * y - s * x)
    found: npt.NDArray[np.bool_] = (along <= boxes[:, None, 2] / 2 + TINY) & (across <= boxes[:, None, 3] / 2 + TINY)
    return found


def _crossings(a: Floats, b: Floats) -> tuple[Floats, npt.NDArray[np.bool_]]:
    """(P, 16, 2) where the lines of the sides cross, and (P, 16) whether they do so within both sides."""
    start, side = a[:, :, None], (np.roll(a, -1, axis=1) - a)[:, :, None]
    other, other_side = b[:, None], (np.roll(b, -1, axis=1) - b)[:, None]
    turn = side[..., 0] * other_side[..., 1] - side[..., 1] * other_side[..., 0]
    off = other - start
    slope = np.where(np.abs(turn) < TINY, 1.0, turn)
    along = (off[..., 0] * other_side[..., 1] - off[..., 1] * other_side[..., 0]) / slope
    across = (off[..., 0] * side[..., 1] - off[..., 1] * side[..., 0]) / slope
    crossed = (np.abs(turn) >= TINY) & (along >= 0) & (along <= 1) & (across >= 0) & (across <= 1)
    places = start + along[..., None] * side
    return places.reshape(len(a), -1, 2), crossed.reshape(len(a), -1)

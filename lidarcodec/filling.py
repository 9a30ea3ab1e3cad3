"""Returns that a receiver interpolates between the columns that were sent.

Two ranges are alike if they differ by at most 0.25 m and 1/20 of the nearer one, and close if by at most half of that.
Returns a and b, next to each other in a row, are on one surface if they are alike, or if the line through one of them
and the return before it meets the column of the other one close to it: so does a wall seen at a flat angle. Between
them the inverse of the range is interpolated. That is exact for a straight line across the beams, as a wall or the road
is: in the plane of the beams a line is 1/r = A cos(phi) + B sin(phi), which is nearly linear over so small an angle.

Elsewhere, and beside a hole, a surface ends somewhere between the two columns. Then each return stands for the half of
the gap next to it, and its surface goes on along that line, if the return before it is close, and as far as the line
stays close, but no farther than the farthest return that was sent. Midway it is the farther of the two. All arithmetic
is in whole numbers, so that every decoder gives equal results.

>>> between(np.array([1000]), np.array([1000]), 1, 4).tolist()
[1000]
>>> between(np.array([1000]), np.array([1100]), 1, 2).tolist()  # nearer than the mean: a wall seen aslant
[1048]
>>> beyond(np.array([1000]), np.array([980]), 1, 2).tolist()  # two columns took 20, one more takes 10
[1010]
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import numpy.typing as npt

from lidarcodec.frame import Frame
from lidarcodec.sensors.images import QUANTITIES

JUMP_M: Final = 0.25
JUMP_SHARE: Final = 20
"""Ranges a and b are alike if |a - b| <= JUMP + min(a, b) // JUMP_SHARE, where JUMP is JUMP_M in range steps, rounded.
They are close if |a - b| <= JUMP // 2 + min(a, b) // (2 JUMP_SHARE)."""
WIDEST: Final = 64
"""Largest gap, in columns, that is filled."""
FOR_PROGRAMS: Final = frozenset({"localise", "detect"})
"""Purposes of streams that programs read: they take every point as measured, so nothing is filled in."""

Whole = npt.NDArray[np.integer[Any]]


def between(a: Whole, b: Whole, place: Whole | int, gap: Whole | int) -> npt.NDArray[np.int64]:
    """Interpolated ranges `place` columns after ranges `a`, where ranges `b` follow `gap` columns after `a`."""
    a, b = a.astype(np.int64), b.astype(np.int64)
    weighted = b * (gap - place) + a * place
    made: npt.NDArray[np.int64] = (2 * a * b * gap + weighted) // np.maximum(2 * weighted, 1)
    return made


def beyond(a: Whole, before: Whole, place: Whole | int, gap: Whole | int) -> npt.NDArray[np.int64]:
    """Ranges `place` columns past ranges `a`, on the line from ranges `before`, which are `gap` columns on the other
    side; 0 where the line leads away for good, or has no beginning."""
    a, before = a.astype(np.int64), before.astype(np.int64)
    weighted = before * gap + (before - a) * place
    met = (2 * a * before * gap + weighted) // np.maximum(2 * weighted, 1)
    gone: npt.NDArray[np.int64] = np.where(weighted > 0, met, 0)
    return gone


class _Gaps:
    """The gaps between neighbouring columns that were sent.

    known: (H, K + 1) ranges; widths: (K,) columns from each to the next; jump: JUMP_M in range steps
    a, b: (H, K) ranges at both ends; one_surface: (H, K) bool, whether one goes on
    from a to b; rows, at: (E,) the gaps in which it does not, but begins
    """

    def __init__(self, known: npt.NDArray[np.int64], widths: npt.NDArray[np.int64], jump: int) -> None:
        self._jump, self._farthest = jump, known.max(initial=0)
        self.a, self.b = known[:, :-1], known[:, 1:]
        self.one_surface = _within(self.a, self.b, jump, JUMP_SHARE)
        rows, at = np.nonzero(~self.one_surface & ((self.a > 0) | (self.b > 0)))
        padded = np.pad(known, ((0, 0), (1, 1)))  # no return before the first one, nor after the last one
        self._ranges = [padded[rows, at + column] for column in range(4)]
        self._widths = [np.pad(widths, 1, constant_values=1)[at + gap] for gap in range(3)]
        before, a, b, after = self._ranges
        width_before, width, width_after = self._widths
        meets = self._close(beyond(a, before, width, width_before), b)
        meets |= self._close(beyond(b, after, width, width_after), a)
        meets &= (a > 0) & (b > 0)
        self.one_surface[rows[meets], at[meets]] = True
        self.rows, self.at = rows[~meets], at[~meets]
        self._ranges = [ranges[~meets] for ranges in self._ranges]
        self._widths = [widths[~meets] for widths in self._widths]

    def edges(self, place: int) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.bool_]]:
        """(E,) ranges `place` columns into the gaps in which a surface ends, and whether they are of that of b."""
        before, a, b, after = self._ranges
        width_before, width, width_after = self._widths
        left = self._edge(a, before, place, width_before)
        right = self._edge(b, after, width - place, width_after)
        is_right = (2 * place > width) | ((2 * place == width) & (right > left))
        return np.where(is_right, right, left), is_right

    def _edge(
        self, a: npt.NDArray[np.int64], before: npt.NDArray[np.int64], place: Whole | int, width: npt.NDArray[np.int64]
    ) -> npt.NDArray[np.int64]:
        """Ranges `place` columns past ranges `a`, where their surfaces end."""
        on = beyond(a, before, place, width)
        goes_on = self._close(before, a) & self._close(on, a) & (on <= self._farthest)
        edge: npt.NDArray[np.int64] = np.where(goes_on, on, a)
        return edge

    def _close(self, a: npt.NDArray[np.int64], b: npt.NDArray[np.int64]) -> npt.NDArray[np.bool_]:
        return _within(a, b, self._jump // 2, 2 * JUMP_SHARE)


def _within(a: npt.NDArray[np.int64], b: npt.NDArray[np.int64], jump: int, share: int) -> npt.NDArray[np.bool_]:
    """Whether ranges, 0 for none, are there and differ by at most `jump` steps and one `share`-th of the nearer one."""
    near = np.minimum(a, b)
    within: npt.NDArray[np.bool_] = (near > 0) & (np.abs(a - b) <= jump + near // share)
    return within


def filled(frame: Frame) -> Frame:
    """The frame with returns interpolated between the columns of its lattice, marked in `filled`.

    A frame without a lattice is returned unchanged. Intensities between two returns of one surface are interpolated
    linearly and rounded down; elsewhere they are those of the return whose surface it is. Of other sensors so are
    `signal` and `near_ir`; all else, such as second returns, is 0 there. Cost: 3 to 8 ms for a turn of an HDL-64E, more
    where fewer columns were sent.
    """
    columns = frame.lattice
    if columns is None or len(columns) < 2 or frame.filled is not None:
        return frame
    places = columns.astype(np.int64)
    widths = places[1:] - places[:-1]
    gaps = _Gaps(frame.range[:, columns].astype(np.int64), widths, round(JUMP_M / frame.sensor.range_step_m))
    images = {"intensity": frame.intensity, **{name: frame.planes[name] for name in frame.planes if name in QUANTITIES}}
    shades = {name: image[:, columns].astype(np.int64) for name, image in images.items()}
    wide = frame.range.copy()
    toned = {name: image.copy() for name, image in images.items()}
    marked = np.zeros(frame.range.shape, np.bool_)
    for place in range(1, int(min(widths.max(), WIDEST))):
        inside = np.flatnonzero((place < widths) & (widths <= WIDEST))
        gap, into, on = widths[inside], places[inside] + place, gaps.one_surface[:, inside]
        wide[:, into] = np.where(on, between(gaps.a[:, inside], gaps.b[:, inside], place, gap), 0)
        within = np.isin(gaps.at, inside)
        edge, is_right = (found[within] for found in gaps.edges(place))
        rows, ends = gaps.rows[within], gaps.at[within]
        wide[rows, places[ends] + place] = edge
        marked[:, into] = wide[:, into] > 0
        for name, shade in shades.items():
            left, right = shade[:, inside], shade[:, inside + 1]
            toned[name][:, into] = np.where(on, (left * (gap - place) + right * place) // gap, 0)
            toned[name][rows, places[ends] + place] = np.where(edge > 0, shade[rows, ends + is_right], 0)
    intensity = toned.pop("intensity")
    return frame.with_(range=wide, intensity=intensity, planes={**frame.planes, **toned}, filled=marked)


def made_up(frame: Frame) -> npt.NDArray[np.bool_]:
    """(N,) bool, whether a receiver interpolated the point, for each point of `Frame.cloud`."""
    valid = frame.valid.T
    return np.zeros(np.count_nonzero(valid), np.bool_) if frame.filled is None else frame.filled.T[valid]


def fills_for(purpose: str) -> bool:
    """Whether receivers fill in returns by default in a stream of that purpose."""
    return purpose not in FOR_PROGRAMS


def measured_only(frame: Frame) -> Frame:
    """The frame without the returns that a receiver interpolated."""
    if frame.filled is None:
        return frame
    return frame.with_(
        range=np.where(frame.filled, np.zeros((), frame.range.dtype), frame.range),
        intensity=np.where(frame.filled, np.zeros((), frame.intensity.dtype), frame.intensity),
        planes={name: np.where(frame.filled, np.zeros((), one.dtype), one) for name, one in frame.planes.items()},
        filled=None,
    )

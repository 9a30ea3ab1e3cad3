"""The range image of a point cloud: for each point a row and a column.

    organised cloud (height above 1)      its own rows and columns
    fields `ring` or `channel`            rows by ring; columns in the order in which the points come, a new one where
                                          the firing order of the rings begins anew, or the direction jumps
    neither                               the turns of the azimuth as rows (points that come ring by ring), or the
                                          elevations, where they form lines; then as with rings

A cloud of none of these has no range image. No two points share a cell.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from lidarcodec import _native
from lidarcodec.sensors.clouds.message import CloudMessage
from lidarcodec.units import MAX_COLUMNS

Numbers = npt.NDArray[np.int64]
Floats = npt.NDArray[np.float64]

MAX_ROWS: Final = 128
MAX_CELLS: Final = 1 << 20
"""Most cells of an image: as many as 128 rows of 8,192 columns."""
RING_FIELDS: Final = ("ring", "channel", "laser_id", "line")
_TURN: Final = 2 * np.pi
_DENSER: Final = 1.02
_MORE_COLUMNS: Final = 8
"""By how much more columns than before show that the order has changed."""


@dataclass(frozen=True, eq=False)
class FiringOrder:
    """How points come column by column. firing: (H,) rings in the order in which they fire; turned: (H,) direction of
    each, radians; jump: radians: a point as far from the one before begins a column; points, columns: that were found
    """

    firing: Numbers
    turned: Floats
    jump: float
    points: int
    columns: int


@dataclass(frozen=True, eq=False)
class Grid:
    """Where points are: `row` and `column`, (N,) each.

    by_column: whether points come column by column, the rows of each in the order of `firing`, (H,); else row by row
    full: whether each cell has a point
    of_field: name of the field that is the row; empty if there is none
    order: how columns were told apart, of points that come column by column
    """

    rows: int
    columns: int
    row: Numbers
    column: Numbers
    by_column: bool
    firing: Numbers
    full: bool
    of_field: str
    order: FiringOrder | None = None

    @property
    def cells(self) -> tuple[int, int, Numbers, Numbers]:
        """As the native core takes it."""
        return self.rows, self.columns, self.row, self.column

    def image(self, values: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """(H, W) of a value a point; 0 where there is none."""
        found = np.zeros((self.rows, self.columns), values.dtype)
        found[self.row, self.column] = values
        return found

    def mask(self) -> npt.NDArray[np.bool_]:
        """(H, W), where points are."""
        found = np.zeros((self.rows, self.columns), np.bool_)
        found[self.row, self.column] = True
        return found


def places_of(mask: npt.NDArray[np.bool_], firing: Numbers, *, by_column: bool) -> tuple[Numbers, Numbers]:
    """Row and column of each point, in the order of the points."""
    if not by_column:
        row, column = np.divmod(np.flatnonzero(mask), mask.shape[1])
        return row, column
    column, rank = np.divmod(np.flatnonzero(np.ascontiguousarray(mask.T)[:, firing]), mask.shape[0])
    return firing[rank], column


def grid_of(message: CloudMessage, before: Grid | None = None) -> Grid | None:
    """The grid of a message; None if its points have no such order. before: of the message before it in a stream."""
    head = message.head
    if not head.points:
        return None
    if 1 < head.height <= MAX_ROWS and head.width <= MAX_COLUMNS and head.points <= MAX_CELLS:
        row, column = np.divmod(np.arange(head.points), head.width)
        return Grid(head.height, head.width, row, column, False, np.arange(head.height), True, "")
    if not message.returns.any():
        return None
    azimuth: Floats | None = None
    for name in RING_FIELDS:
        rings = message.values(name)
        if rings is not None and rings.dtype.kind in "ui" and int(rings.min()) >= 0 and int(rings.max()) < MAX_ROWS:
            rings = rings.astype(np.int64)
            found = None if before is None or before.of_field != name else _as_before(message, rings, before)
            if found is None:
                azimuth = _azimuth(message) if azimuth is None else azimuth
                found = _by_rings(message, rings, azimuth, name)
            if found is not None:
                return found
    azimuth = _azimuth(message) if azimuth is None else azimuth
    turns = _by_turns(azimuth)
    if turns is not None:
        return turns
    lines = _lines(message)
    return None if lines is None else _by_rings(message, lines, azimuth, "")


class GridFinder:
    """Finds the grids of the messages of a stream."""

    def __init__(self) -> None:
        self._last: Grid | None = None

    def find(self, message: CloudMessage) -> Grid | None:
        """The grid of the next message; None if its points have no order."""
        self._last = grid_of(message, self._last)
        return self._last


def _as_before(message: CloudMessage, rings: Numbers, before: Grid) -> Grid | None:
    """The grid by the order of the one before; None if that needs many more columns."""
    order = before.order
    if order is None or int(rings.max()) >= before.rows:
        return None
    found = _ordered(message, rings, order, before.of_field)
    if found is None or found.columns > _DENSER * order.columns * len(rings) / order.points + _MORE_COLUMNS:
        return None
    return found


def _ordered(message: CloudMessage, rings: Numbers, order: FiringOrder, name: str) -> Grid | None:
    """The grid of points that come in an order; None if it has too many columns."""
    rank = np.argsort(order.firing)
    with np.errstate(over="ignore", invalid="ignore"):  # of points without a return
        x, y = (np.asarray(message.values(axis)).astype(np.float32, copy=False) for axis in "xy")
        column = _native.columns_of_firing(rank, order.turned, order.jump, rings, x, y, message.returns.view(np.uint8))
    rows, columns = len(order.firing), int(column[-1]) + 1
    if columns > MAX_COLUMNS or rows * columns > max(8 * len(rings), 4096) or rows * columns > MAX_CELLS:
        return None
    return Grid(rows, columns, rings, column, True, order.firing, len(rings) == rows * columns, name, order)


def _azimuth(message: CloudMessage) -> Floats:
    """(N,) direction of each point in radians; of a point without a return that of the one before."""
    assert message.xyz is not None
    x, y, _ = np.where(message.returns, message.xyz, 0.0)
    azimuth: Floats = np.arctan2(y, x)
    if not message.returns.all():
        last = np.maximum.accumulate(np.where(message.returns, np.arange(len(azimuth)), 0))
        azimuth = azimuth[last]
    return azimuth


def _wrapped(angle: Floats) -> Floats:
    found: Floats = angle - np.rint(angle / _TURN) * _TURN
    return found


def _by_rings(message: CloudMessage, rings: Numbers, azimuth: Floats, name: str) -> Grid | None:
    """Points that come column by column, or, where that needs too many columns, row by row."""
    rows = int(rings.max()) + 1
    if len(rings) > 1 and np.mean(np.diff(rings) == 0) > 0.5:
        return _row_by_row(rings, azimuth, rows, name)
    firing = _firing_order(rings, rows)
    rank = np.argsort(firing)[rings]
    anew = np.ones(len(rings), np.bool_)
    anew[1:] = rank[1:] <= rank[:-1]
    begins, offset, jump = anew, np.zeros(rows), np.inf
    for _ in range(3):  # rings look in different directions: learn by how much, then cut where the direction jumps
        for _ in range(2):
            level = azimuth - offset[rings]
            turned = _wrapped(level - level[begins][np.cumsum(begins) - 1])
            offset += _medians(turned, rings, rows)
        steps = np.abs(_wrapped(np.diff(azimuth - offset[rings], prepend=azimuth[:1] - offset[rings[:1]])))
        jump = _jump(steps, anew)
        begins = anew | (steps > jump)
    found = _ordered(message, rings, FiringOrder(firing, offset, jump, len(rings), int(np.count_nonzero(begins))), name)
    if found is None or found.order is None:
        return found
    return replace(found, order=replace(found.order, columns=found.columns))


def _jump(steps: Floats, anew: npt.NDArray[np.bool_]) -> float:
    """Radians from which on a point is in another direction than the one before: more than half a column.

    steps: (N,) radians from the point before; anew: where the firing order begins anew
    """
    between = steps[anew][1:]
    jump = max(0.6 * float(np.median(between)) if len(between) else np.inf, 1e-4)
    jumps = np.count_nonzero(steps[~anew] > jump)
    # Lasers beside the axis look in directions that depend on the range: then these are no jumps.
    return jump if jumps < 0.3 * np.count_nonzero(anew) else np.inf


def _medians(values: Floats, rings: Numbers, rows: int) -> Floats:
    """(H,) median of the values of each ring, of some of them; 0 where there are none."""
    found = np.zeros(rows)
    step = max(1, len(rings) // (256 * rows))
    values, rings = values[::step], rings[::step]
    order = np.argsort(rings, kind="stable")
    for ring, part in enumerate(np.split(values[order], np.searchsorted(rings[order], np.arange(1, rows)))):
        if len(part):
            found[ring] = np.median(part)
    return found


def _firing_order(rings: Numbers, rows: int) -> Numbers:
    """(H,) rings in the order in which they fire: mostly, each is followed by the next."""
    follows = np.bincount(rings[:-1] * rows + rings[1:], minlength=rows * rows).reshape(rows, rows)
    np.fill_diagonal(follows, 0)
    after = follows.argmax(axis=1)
    chain = [int(rings[0])]
    left = set(range(rows)) - {chain[0]}
    while int(after[chain[-1]]) in left:
        chain.append(int(after[chain[-1]]))
        left.remove(chain[-1])
    while left:
        fits = [ring for ring in sorted(left, reverse=True) if int(after[ring]) in chain and follows[ring].any()]
        for ring in fits or sorted(left):
            chain.insert(chain.index(int(after[ring])) if fits else len(chain), ring)
            left.remove(ring)
            if fits:
                break
    return np.array(chain, np.int64)


def _row_by_row(rings: Numbers, azimuth: Floats, rows: int, name: str) -> Grid | None:
    """Points that come ring by ring: columns by azimuth, at least one after the point before."""
    if (np.diff(rings) < 0).any():
        return None
    steps = np.abs(_wrapped(np.diff(azimuth)))[np.diff(rings) == 0]
    step = float(np.median(steps)) if len(steps) else 0.0
    if not 1e-5 < step < 0.2:
        return None
    begins = np.flatnonzero(np.diff(rings, prepend=-1))
    starts = np.zeros(rows, np.int64)
    starts[rings[begins]] = begins
    forward = np.sign(np.median(_wrapped(np.diff(azimuth))[np.diff(rings) == 0])) or 1.0
    origin = azimuth[0]
    turned = np.mod((azimuth - origin) * forward + 0.25, _TURN)
    column = (turned / step).astype(np.int64)
    place = np.arange(len(rings)) - starts[rings]
    column = np.maximum.accumulate(column - place + rings * 10**7) - rings * 10**7 + place
    column -= column.min()
    columns = int(column.max()) + 1
    if columns > MAX_COLUMNS or rows * columns > max(8 * len(rings), 4096) or rows * columns > MAX_CELLS:
        return None
    return Grid(rows, columns, rings, column, False, np.arange(rows), False, name)


def _by_turns(azimuth: Floats) -> Grid | None:
    """Points that come turn by turn: a row ends where the azimuth has passed that of the first point."""
    steps = _wrapped(np.diff(azimuth))
    forward = np.sign(np.median(steps)) if len(steps) else 0.0
    if forward == 0 or np.mean(np.sign(steps) == forward) < 0.8:
        return None
    turned = np.mod((azimuth - azimuth[0]) * forward, _TURN)
    row = np.concatenate(([0], np.cumsum(np.diff(turned) < -np.pi)))
    rows = int(row[-1]) + 1
    return _row_by_row(row, azimuth, rows, "") if rows <= MAX_ROWS else None


def _lines(message: CloudMessage) -> Numbers | None:
    """(N,) number of the line of elevation of each point, the highest first; None if they form no lines."""
    assert message.xyz is not None
    x, y, z = np.where(message.returns, message.xyz, 0.0)
    elevation = np.arctan2(z, np.hypot(x, y))
    order = np.argsort(elevation, kind="stable")
    gaps = np.diff(elevation[order])
    cut = gaps > 0.0007  # 0.04 degree; beams are 0.1 degree apart or more
    lines = int(np.count_nonzero(cut)) + 1
    if not 4 <= lines <= MAX_ROWS:
        return None
    number = np.empty(len(elevation), np.int64)
    number[order] = np.concatenate(([0], np.cumsum(cut)))
    return lines - 1 - number

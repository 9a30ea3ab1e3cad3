"""What stands in a zone: points of any number of vehicles, in one frame, to alerts that come and go.

A zone is a polygon, divided into cells. A cell that holds points above the ground is occupied, one in which the ground
is seen is free, and one that nobody sees stays what it was. What is occupied for `stand` tenths of a second stands, and
raises an alert; a cell that was seen free for `clear` of them no longer does. So a car that passes raises none, and one
that is hidden for a moment is not forgotten.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

SLOT_NS = 100_000_000
"""A cell counts once in this time, however many vehicles see it."""
MARGIN_M = 5.0
"""The ground of a zone is looked for so far around it, too."""
GROUND_CELL_M = 1.0
LEAST_CELLS = 6
MOST_M = 1000.0
"""A zone is no longer and no wider: its cells are kept in memory."""


@dataclass(frozen=True)
class Rules:
    """When something stands. stand, clear: tenths of a second; lowest, highest: metres over the ground."""

    stand: int = 20
    clear: int = 8
    lowest_m: float = 0.3
    highest_m: float = 3.0
    cell_m: float = 0.5
    least_points: int = 3
    forget_s: float = 10.0


@dataclass(frozen=True)
class Event:
    """An alert that was raised or cleared: where the thing stands, since when, and who saw it."""

    zone: str
    raised: bool
    stamp_ns: int
    since_ns: int
    position_m: tuple[float, float]
    size_m: tuple[float, float]
    vehicles: tuple[str, ...]

    def plain(self) -> dict[str, Any]:
        """For JSON."""
        return {**self.__dict__, "position_m": list(self.position_m), "size_m": list(self.size_m),
                "vehicles": list(self.vehicles)}  # fmt: skip


def inside(places: np.ndarray, polygon: np.ndarray) -> np.ndarray:
    """(N,) bool, which of (N, 2) places lie in a polygon (M, 2), by the number of its edges to their right."""
    x, y = places[:, 0], places[:, 1]
    found = np.zeros(len(places), np.bool_)
    for (x0, y0), (x1, y1) in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        if y0 != y1:
            crosses = (y0 > y) != (y1 > y)
            found ^= crosses & (x < x0 + (y - y0) * (x1 - x0) / (y1 - y0))
    return found


def ground_plane(points: np.ndarray) -> np.ndarray | None:
    """a, b, c of the ground z = a x + b y + c under (N, 3) points; None if too little of it is seen.

    A plane through the lowest point of each square metre; what lies above it is left out, and it is fitted again.
    """
    if not len(points):
        return None
    cells = np.floor(points[:, :2] / GROUND_CELL_M).astype(np.int64)
    _, inverse = np.unique(cells, axis=0, return_inverse=True)
    order = np.lexsort((points[:, 2], inverse.ravel()))
    first = np.flatnonzero(np.diff(inverse.ravel()[order], prepend=-1))
    lows = points[order[first]]
    if len(lows) < LEAST_CELLS:
        return None
    sides = np.column_stack([lows[:, :2], np.ones(len(lows))])
    kept = lows[:, 2] <= np.median(lows[:, 2]) + 0.5
    plane = np.zeros(3)
    for _ in range(5):
        plane, *_ = np.linalg.lstsq(sides[kept], lows[kept, 2], rcond=None)
        above = lows[:, 2] - sides @ plane
        kept = np.abs(above) <= max(0.1, 2.0 * float(np.median(np.abs(above[kept]))))
        if kept.sum() < LEAST_CELLS:
            return None
    return plane


def check_polygon(polygon: np.ndarray) -> None:
    """Raises ValueError unless it is an area: (M, 2) corners, with edges that do not cross each other."""
    if polygon.ndim != 2 or polygon.shape[1] != 2 or len(polygon) < 3:
        raise ValueError("it needs three corners or more, of x and y")
    if not np.isfinite(polygon).all() or (np.ptp(polygon, axis=0) > MOST_M).any():
        raise ValueError(f"its corners are numbers, at most {MOST_M:g} m apart")
    if _crosses(polygon):
        raise ValueError("its edges cross each other: name the corners in turn, around it")
    x, y = (polygon - polygon[0]).T
    if abs(float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))) < 1e-6:
        raise ValueError("its corners lie in a line")


def _crosses(polygon: np.ndarray) -> bool:
    """Whether two edges of a polygon go through each other."""
    edges = [*zip(polygon, np.roll(polygon, -1, axis=0), strict=True)]

    def side(of: tuple[np.ndarray, np.ndarray], place: np.ndarray) -> float:
        (x0, y0), (x1, y1) = of
        return float(np.sign((x1 - x0) * (place[1] - y0) - (y1 - y0) * (place[0] - x0)))

    return any(
        side(a, b[0]) * side(a, b[1]) < 0 and side(b, a[0]) * side(b, a[1]) < 0
        for number, a in enumerate(edges)
        for b in edges[:number]
    )


class Zone:
    """A polygon of the common frame, and what stands in it. things: (N, 3), what each vehicle saw in it last."""

    def __init__(self, name: str, polygon: Sequence[Sequence[float]], rules: Rules | None = None) -> None:
        """Raises ValueError for no name, and for corners that make no area."""
        self.name, self.rules = name, rules or Rules()
        if not name:
            raise ValueError("it needs a name")
        self.polygon = np.array(polygon if len({len(corner) for corner in polygon}) == 1 else [], np.float64)
        check_polygon(self.polygon)
        self._low = self.polygon.min(axis=0)
        size = np.ceil((self.polygon.max(axis=0) - self._low) / self.rules.cell_m).astype(int) + 1
        self._score = np.zeros(tuple(size), np.int32)
        self._slot = np.full(tuple(size), -1, np.int64)
        self._since_ns: int | None = None
        self._seen_ns: dict[str, int] = {}
        self.things: dict[str, np.ndarray] = {}

    @property
    def alert(self) -> bool:
        """Whether something stands here."""
        return self._since_ns is not None

    def see(self, points: np.ndarray, stamp_ns: int, vehicle: str) -> Event | None:
        """Take (N, 3) points of a vehicle in the common frame; the alert that this raises or clears, if any."""
        self._seen_ns[vehicle] = stamp_ns
        near = points[
            np.all((points[:, :2] > self._low - MARGIN_M) & (points[:, :2] < self.polygon.max(axis=0) + MARGIN_M), 1)
        ]
        plane = ground_plane(near)
        if plane is None:
            self.things.pop(vehicle, None)
            return self._judged(stamp_ns)
        within = near[inside(near[:, :2], self.polygon)]
        height = within[:, 2] - within[:, :2] @ plane[:2] - plane[2]
        things = within[(height >= self.rules.lowest_m) & (height <= self.rules.highest_m)]
        self.things[vehicle] = things
        self._count(things, within[np.abs(height) < self.rules.lowest_m], stamp_ns // SLOT_NS)
        return self._judged(stamp_ns)

    def go_on(self, stamp_ns: int) -> Event | None:
        """Time goes on, also if nobody looks; the alert that this clears, if any."""
        lost = [name for name, seen_ns in self._seen_ns.items() if stamp_ns - seen_ns > self.rules.forget_s * 1e9]
        for vehicle in lost:
            del self._seen_ns[vehicle]
            self.things.pop(vehicle, None)
        return self._judged(stamp_ns)

    def state(self) -> dict[str, Any]:
        """For JSON: where the zone is, and whether something stands in it."""
        position, size = self._where()
        return {
            "name": self.name, "polygon": self.polygon.tolist(), "alert": self.alert, "since_ns": self._since_ns,
            "position_m": list(position) if self.alert else None, "size_m": list(size) if self.alert else None,
        }  # fmt: skip

    def _hits(self, points: np.ndarray) -> np.ndarray:
        cells = np.floor((points[:, :2] - self._low) / self.rules.cell_m).astype(int)
        hits = np.zeros(self._score.shape, np.int32)
        np.add.at(hits, (cells[:, 0], cells[:, 1]), 1)
        return hits >= self.rules.least_points

    def _count(self, things: np.ndarray, ground: np.ndarray, slot: int) -> None:
        rules = self.rules
        occupied = self._hits(things)
        free = self._hits(ground) & ~occupied
        due = self._slot < slot
        self._score[occupied & due] += 1
        self._score[free & due] -= max(1, rules.stand // rules.clear)
        np.clip(self._score, 0, rules.stand, out=self._score)
        self._slot[(occupied | free) & due] = slot

    def _judged(self, stamp_ns: int) -> Event | None:
        rules = self.rules
        forgotten = self._slot < stamp_ns // SLOT_NS - round(rules.forget_s * 1e9 / SLOT_NS)
        self._score[forgotten] = 0
        stands = bool((self._score >= rules.stand).any())
        if not self.alert and stands:
            self._since_ns = stamp_ns - rules.stand * SLOT_NS
            return self._event(stamp_ns, self._since_ns, raised=True)
        if self._since_ns is not None and not (self._score > 0).any():
            since_ns, self._since_ns = self._since_ns, None
            return self._event(stamp_ns, since_ns, raised=False)
        return None

    def _event(self, stamp_ns: int, since_ns: int, *, raised: bool) -> Event:
        seeing = tuple(sorted(name for name, things in self.things.items() if len(things)))
        return Event(self.name, raised, stamp_ns, since_ns, *self._where(), seeing)

    def _where(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Middle and size of what stands, or would soon."""
        cells = np.argwhere(self._score >= self.rules.stand)
        if not len(cells):
            middle = self.polygon.mean(axis=0)
            return (round(float(middle[0]), 2), round(float(middle[1]), 2)), (0.0, 0.0)
        low = self._low + cells.min(axis=0) * self.rules.cell_m
        high = self._low + (cells.max(axis=0) + 1) * self.rules.cell_m
        middle, size = (low + high) / 2, high - low
        return (round(float(middle[0]), 2), round(float(middle[1]), 2)), (
            round(float(size[0]), 2),
            round(float(size[1]), 2),
        )

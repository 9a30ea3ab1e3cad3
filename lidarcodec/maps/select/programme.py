"""`paper` and `lp`: the integer programme of Zhang et al. for map compression, by its linear relaxation with HiGHS.

    min q'x + lambda 1'z   so that   A x + z >= b 1,   x binary, z >= 0

x says which points are kept, z by how many points a place of the path falls short of b. A says which place sees which
point, here from the first to the last one that hit it. q is 1 - (n - min n) / (max n - min n) with the count n cut at
100, as the authors' code has it, and a thousandth more: points that were seen often cost less, and none is free. With
`lp` all points cost the same, so that it chooses those that most places see.

Points that the same places see and that cost the same are one variable with an upper bound. That changes nothing in the
programme, and makes it so small that a drive of kilometres is solved in seconds. A long path is solved in sections of
300 places, one after the other. From the duals of all sections follows a bound below that no choice can be, and so the
gap of the choice that was made. b is searched so that the number of points is the wanted one.
"""

from __future__ import annotations

import os
import sys
import time
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from lidarcodec.errors import LidarCodecError, MissingExtraError
from lidarcodec.maps.points import MapPoints
from lidarcodec.maps.select.result import Selection, check_seen

LAMBDA: Final = 0.1
MOST_COUNT: Final = 100
LEAST_COST: Final = 1e-3
SECTION: Final = 300
_TRIES: Final = 20
_CLOSE: Final = 0.001
Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]


@dataclass(frozen=True)
class _Groups:
    """Points that are alike for the programme. first, last: places that see them; cost: q; size: their number; of: (N,)
    group of each point"""

    first: Ints
    last: Ints
    cost: Floats
    size: Ints
    of: Ints


@dataclass(frozen=True)
class _Solved:
    """b: of the programme; taken: points of each group; bound: no choice has a smaller value"""

    b: float
    taken: Ints
    bound: float


def paper(points: MapPoints, count: int, seed: int) -> Selection:
    """Exactly `count` points: those of the programme. Raises as `places_of`."""
    places, about = places_of(points, count, seed)
    return Selection(points.taken(places), about)


def lp(points: MapPoints, count: int, seed: int) -> Selection:
    """As `paper`, with the same cost for each point."""
    places, about = places_of(points, count, seed, alike=True)
    return Selection(points.taken(places), about)


def places_of(points: MapPoints, count: int, seed: int, *, alike: bool = False) -> tuple[Ints, dict[str, Any]]:
    """(count,) numbers of the points of the programme, with b as large as they allow, and what is known of the choice.

    alike: whether all points cost the same
    Raises SettingsError for a map that does not say from where points were seen, MissingExtraError without HiGHS.
    """
    began = time.monotonic()
    name = "lp" if alike else "paper"
    check_seen(points, name)
    if find_spec("highspy") is None:
        raise MissingExtraError(f"--by {name}", "maps")
    groups, places = _groups(points, alike), len(points.path)
    most = float(_seen(groups, groups.size, places).max())
    price, over = LAMBDA, _solved(groups, places, most, LAMBDA)
    while over.taken.sum() < count:
        price *= 2  # at this price more points are not worth their cost, whatever b is
        over = _solved(groups, places, most, price)
    under = _Solved(0.0, np.zeros(len(groups.size), np.int64), 0.0)
    for _ in range(_TRIES):
        if under.taken.sum() >= (1 - _CLOSE) * count:
            break
        middle = (under.b + over.b) / 2 if under.b else over.b / 4
        solved = _solved(groups, places, middle, price)
        under, over = (solved, over) if solved.taken.sum() <= count else (under, solved)
    taken = _exactly(groups, under.taken, over.taken, count)
    gap, b = min((_gap(groups, taken, places, one, price), one.b) for one in (over, under))
    about: dict[str, Any] = {
        "b": round(b, 1),
        "lambda": price,
        "gap": round(gap, 5),
        "seconds": round(time.monotonic() - began, 1),
    }
    return _members(groups, taken, seed), about


def _exactly(groups: _Groups, few: Ints, many: Ints, count: int) -> Ints:
    """The points of `few`, and the cheapest of those that only `many` has, `count` together."""
    more = np.maximum(many - few, 0)
    order = np.argsort(groups.cost, kind="stable")
    left = count - int(few.sum()) - (np.cumsum(more[order]) - more[order])
    found = few.copy()
    found[order] += np.clip(left, 0, more[order])
    return found


def _gap(groups: _Groups, taken: Ints, places: int, solved: _Solved, price: float) -> float:
    """By what share the value of a choice lies above the bound."""
    short = np.maximum(solved.b - _seen(groups, taken, places), 0.0)
    value = float(groups.cost @ taken + price * short.sum())
    return max(value - solved.bound, 0.0) / solved.bound if solved.bound > 0 else np.inf


def _groups(points: MapPoints, alike: bool = False) -> _Groups:
    counts = np.minimum(points.columns["count"].astype(np.int64), 1 if alike else MOST_COUNT)
    rows = np.stack([points.columns["first"].astype(np.int64), points.columns["last"].astype(np.int64), counts], axis=1)
    kinds, of, size = np.unique(rows, axis=0, return_inverse=True, return_counts=True)
    span = max(int(counts.max() - counts.min()), 1)
    return _Groups(
        kinds[:, 0],
        kinds[:, 1],
        1 - (kinds[:, 2] - counts.min()) / span + LEAST_COST,
        size.astype(np.int64),
        of.reshape(-1),
    )


def _solved(groups: _Groups, places: int, b: float, price: float) -> _Solved:
    """The relaxation in sections, rounded and repaired."""
    taken, duals = np.zeros(len(groups.size), np.int64), np.zeros(places)
    for begin in range(0, places, SECTION):
        end = min(begin + SECTION, places)
        inside = np.flatnonzero((groups.first >= begin) & (groups.first < end))
        short = np.maximum(b - _seen(groups, taken, places)[begin:end], 0.0)
        if len(inside) and short.max() > 0:
            parts, duals[begin:end] = _relaxed(groups, inside, short, begin, end, price)
            taken[inside] = _rounded(groups, inside, parts, short, begin, end, price)
    y = np.clip(duals, 0.0, price)
    gained = np.concatenate([[0.0], np.cumsum(y)])
    reduced = groups.cost - (gained[groups.last + 1] - gained[groups.first])
    bound = float(b * y.sum() + (groups.size * np.minimum(reduced, 0.0)).sum())
    return _Solved(b, taken, bound)


def _seen(groups: _Groups, taken: Ints | Floats, places: int) -> Floats:
    """(places,) number of the taken points that each place sees."""
    change = np.zeros(places + 1)
    np.add.at(change, groups.first, taken)
    np.add.at(change, groups.last + 1, -taken)
    return np.cumsum(change)[:-1]


def _relaxed(groups: _Groups, inside: Ints, short: Floats, begin: int, end: int, price: float) -> tuple[Floats, Floats]:
    """Parts of the groups `inside` that are taken, and the dual of each place of a section."""
    import highspy

    first = groups.first[inside] - begin
    lengths = np.minimum(groups.last[inside], end - 1) - begin - first + 1
    starts = np.concatenate([[0], np.cumsum(lengths)])
    rows = np.arange(starts[-1]) - np.repeat(starts[:-1] - first, lengths)
    count, height = len(inside), end - begin
    model = highspy.HighsLp()
    model.num_col_, model.num_row_ = count + height, height
    model.col_cost_ = np.concatenate([groups.cost[inside], np.full(height, price)])
    model.col_lower_ = np.zeros(count + height)
    model.col_upper_ = np.concatenate([groups.size[inside].astype(np.float64), np.full(height, highspy.kHighsInf)])
    model.row_lower_, model.row_upper_ = short, np.full(height, highspy.kHighsInf)
    model.a_matrix_.format_ = highspy.MatrixFormat.kColwise
    model.a_matrix_.start_ = np.concatenate([starts, starts[-1] + 1 + np.arange(height)]).astype(np.int32)
    model.a_matrix_.index_ = np.concatenate([rows, np.arange(height)]).astype(np.int32)
    model.a_matrix_.value_ = np.ones(int(starts[-1]) + height)
    solver = _silent_solver()
    solver.setOptionValue("threads", 1)
    solver.passModel(model)
    solver.run()
    if solver.getModelStatus() != highspy.HighsModelStatus.kOptimal:
        raise LidarCodecError(
            f"HiGHS could not solve the integer programme of --by paper or lp: {solver.getModelStatus().name}"
        )
    solution = solver.getSolution()
    return np.array(solution.col_value)[:count], np.array(solution.row_dual)


def _rounded(groups: _Groups, inside: Ints, parts: Floats, short: Floats, begin: int, end: int, price: float) -> Ints:
    """Whole numbers: each fraction is rounded down, and up again where that makes the value smaller."""
    taken = np.floor(parts + 1e-6).astype(np.int64)
    first, last = groups.first[inside] - begin, np.minimum(groups.last[inside], end - 1) - begin
    left = short.copy()
    change = np.zeros(end - begin + 1)
    np.add.at(change, first, taken)
    np.add.at(change, last + 1, -taken)
    left -= np.cumsum(change)[:-1]
    for at in np.argsort(taken - parts, kind="stable"):
        if parts[at] - taken[at] < 1e-6:
            break
        saved = np.clip(left[first[at] : last[at] + 1], 0.0, 1.0).sum() * price
        if saved > groups.cost[inside[at]]:
            taken[at] += 1
            left[first[at] : last[at] + 1] -= 1
    return taken


def _members(groups: _Groups, taken: Ints, seed: int) -> Ints:
    """Places of points: of each group as many as are taken, by lot."""
    lots = np.random.default_rng(seed).permutation(len(groups.of))
    order = lots[np.argsort(groups.of[lots], kind="stable")]
    starts = np.concatenate([[0], np.cumsum(groups.size)[:-1]])
    rank = np.arange(len(order)) - np.repeat(starts, groups.size)
    found: Ints = np.sort(order[rank < np.repeat(taken, groups.size)])
    return found


def _silent_solver() -> Any:
    """A solver of HiGHS, which prints its name on the standard output as it is made: results are printed there."""
    import highspy

    sys.stdout.flush()
    kept, nowhere = os.dup(1), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    try:
        solver: Any = highspy.Highs()  # type: ignore[no-untyped-call]  # it has no types for its methods
        solver.silent()
    finally:
        os.dup2(kept, 1)
        os.close(kept)
        os.close(nowhere)
    return solver

"""Operating curves: for each number of bits the working point that shows most, out of what was measured.

A working point is a step of the lattice of columns, a value of the codec's knob and a number of intensity levels.
`working_points.json` has, for each codec, what points of a grid took and showed on training drives (how:
`benchmarks/working_points.py`). From it a curve is made for what the operator left free: what is pinned stays, the
rest moves. Along a curve more bits never show less: neither distances, nor errors of intensity, nor the step grow.

>>> curve = operating_curve("riddle", Pins())
>>> bool((np.diff(curve.bits) > 0).all()), bool((np.diff(curve.cost) < 0).all())
(True, True)
>>> {point.step for point in operating_curve("riddle", Pins(step=1)).points}
{1}
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from lidarcodec.codecs import table
from lidarcodec.codecs.rate_knob import BOUND
from lidarcodec.errors import SettingsError
from lidarcodec.ratecontrol.chain import chain
from lidarcodec.settings import Purpose, step_of
from lidarcodec.units import RANGE_STEP_M

Floats = npt.NDArray[np.float64]

RETURNS_A_SECOND: Final = 1_100_000
"""Of an HDL-64E in a street, in single return."""
COARSEST_M: Final = 0.3
"""No automatic choice makes a larger range error, nor a larger RMSE of a codec that keeps no bound."""
COARSEST_RMSE_M: Final = 0.2
"""RMSE on training drives up to which a codec without a bound is used: other scenes are rougher."""
SPARSE_RMSE_M: Final = 0.1
"""The same where a reducer chose returns: their neighbours in the picture are farther off than when it was measured."""
INTENSITY_M: Final = 1e-4
"""What a squared error of intensity (of 255) weighs, in metres of Chamfer distance, up to INTENSITY_KNEE."""
INTENSITY_KNEE: Final = 18.0
"""RMSE of intensity up to which shades are seen, and not only what is bright and what is dark."""
INTENSITY_BEYOND_M: Final = 4e-4
"""What a step of RMSE weighs just beyond the knee, in metres; at twice that RMSE it weighs half, and so on."""


class WorkingPoint(NamedTuple):
    """step: every step-th column is sent, or one return in so many; value: of the codec's knob; levels: of intensity,
    256 lossless, 0 none."""

    step: int
    value: float
    levels: int


class Pins(NamedTuple):
    """What is pinned; None is free.

    step: of the lattice; levels: of intensity; bound_m: the coarsest; value: of the knob of a codec without a bound
    sparse: whether a reducer chooses the returns otherwise than when the points were measured
    """

    step: int | None = None
    levels: int | None = None
    bound_m: float | None = None
    value: float | None = None
    purpose: Purpose = "look"
    sparse: bool = False


@dataclass(frozen=True, eq=False)
class Curve:
    """points: from fewest bits to most; of each point (N,): `range`, `intensity` and `rest`, in bits per return of the
    original frame; `chamfer_m` and `shades`, the distance in metres and the RMSE of intensity, of 255, both with gaps
    filled in; and `cost`, what is missing from the picture, in metres. None of these three ever grows."""

    points: tuple[WorkingPoint, ...]
    range: Floats
    intensity: Floats
    rest: Floats
    cost: Floats
    chamfer_m: Floats
    shades: Floats

    @property
    def bits(self) -> Floats:
        """(N,) bits per return of the original frame, all in all."""
        return self.range + self.intensity + self.rest


@lru_cache(maxsize=8)
def _measured(purpose: Purpose = "look") -> dict[str, Any]:
    """What was measured for a purpose, by codec. What a point is worth stands in for the Chamfer distance where it is
    something else: a car's distance from its place (`localise`), that of things to what is sent (`detect`)."""
    found = _read("working_points_localise.json" if purpose == "localise" else "working_points.json")
    if purpose == "localise":
        for entry in found.values():
            entry["chamfer_m"] = entry["cost_m"]
            entry["intensity_rmse"] = np.zeros_like(entry["intensity_bits"])
    if purpose == "detect":
        things = _read("working_points_detect.json")
        for entry in found.values():
            entry["chamfer_m"] = _worth_of(things, entry)
    return found


def _read(name: str) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(files("lidarcodec.ratecontrol").joinpath(name).read_text())
    return found


def _worth_of(things: dict[str, Any], entry: dict[str, Any]) -> list[list[float]]:
    """What points are worth to a detector, by step and value: a codec without a bound as one with the same RMSE."""
    bounds = np.sqrt(3.0) * np.array(entry["rmse_m"])
    if entry["bounded"]:
        bounds = np.broadcast_to(np.array(entry["values"]), bounds.shape)
    rows = [things["missed_m"][things["steps"].index(step)] for step in entry["steps"]]
    found = [np.interp(at, things["bounds_m"], row) for at, row in zip(bounds, rows, strict=True)]
    worth: list[list[float]] = np.array(found).tolist()
    return worth


def has_curve(codec: str) -> bool:
    """Whether the working points of a codec were measured. Only such a codec is chosen by `auto`."""
    return codec in _measured()


def _points(codec: str, purpose: Purpose) -> dict[str, Any]:
    """What was measured of a codec; else of the measured codec with the same knob that takes the most bits.

    Rate control begins with it, and corrects it by what is sent.
    """
    found = _measured(purpose)
    if codec in found:
        entry: dict[str, Any] = found[codec]
        return entry
    knob = table.codec(codec).knob
    alike = [entry for entry in found.values() if knob is not None and entry["knob"] == knob.setting]
    if not alike:
        raise SettingsError(f"no working points of codec {codec} were measured, and none with its knob", "codec")
    return max(alike, key=lambda entry: float(entry["range_bits"][0][-1]))


@lru_cache(maxsize=64)
def operating_curve(codec: str, pins: Pins) -> Curve:
    """The curve of a codec around what is pinned. At least one point.

    Where a pinned value was not measured, what lies nearest is where the rate control begins to learn. A codec that was
    not measured has the curve of the most similar one (`has_curve`).
    """
    if pins.purpose in ("localise", "detect") and pins.levels is None:
        pins = pins._replace(levels=0)
    thinned = pins.purpose != "localise" or pins.step is None
    entry = _points(codec, pins.purpose if thinned else "look")
    values, grids = _fine(entry, codec, pins.bound_m)
    steps = np.array(entry["steps"])
    levels = np.array(entry["levels"])
    allowed_steps = steps if pins.step is None else steps[[np.abs(np.log(steps / pins.step)).argmin()]]
    if pins.purpose == "archive":
        allowed_steps = allowed_steps[:1]
    allowed_levels = levels if pins.levels is None else levels[[np.abs(levels - pins.levels).argmin()]]
    fine_enough = _allowed(entry, codec, values, grids["rmse_m"], pins)
    shades = np.array(entry["intensity_rmse"])
    shades[:, levels == 0] = shades.max()  # none is none, whichever columns have none
    parts: list[list[Floats]] = []
    for step in allowed_steps:
        at = int(np.flatnonzero(steps == step)[0])
        for of in np.flatnonzero(np.isin(levels, allowed_levels)):
            chosen = np.flatnonzero(fine_enough[at])
            ones = np.ones(len(chosen))
            parts.append(
                [ones * step, values[chosen], ones * levels[of], grids["range_bits"][at, chosen],
                 ones * entry["intensity_bits"][at][of], ones * entry["rest_bits"][at],
                 grids["chamfer_m"][at, chosen], ones * shades[at, of]]
            )  # fmt: skip
    found = np.array([np.concatenate(column) for column in zip(*parts, strict=True)])
    cost = found[6] + _missed(found[7])
    kept = chain(found[3] + found[4] + found[5], cost, found[[0, 6, 7]])
    points = tuple(
        WorkingPoint(pins.step or int(step), float(value), int(level) if pins.levels is None else pins.levels)
        for step, value, level in found[:3, kept].T
    )
    ranges, intensity, rest, chamfer_m, rmse = found[3:, kept]
    return Curve(points, ranges, intensity, rest, cost[kept], chamfer_m, rmse)


def _missed(rmse: Floats) -> Floats:
    """What RMSEs of intensity weigh, in metres; same shape."""
    beyond = INTENSITY_KNEE * np.log(np.maximum(rmse / INTENSITY_KNEE, 1.0))
    missed: Floats = INTENSITY_M * np.minimum(rmse, INTENSITY_KNEE) ** 2 + INTENSITY_BEYOND_M * beyond
    return missed


def _fine(entry: dict[str, Any], codec: str, bound_m: float | None) -> tuple[Floats, dict[str, Floats]]:
    """All values of the knob between those that were measured, a pinned bound too, and the measured grids at them."""
    knob = table.codec(codec).knob
    assert knob is not None
    places: Floats = np.array(knob.places(entry["values"]))
    own = () if bound_m is None or knob.setting != BOUND else ((step_of(bound_m) - 1) // 2 * RANGE_STEP_M,)
    all_values = np.unique([*knob.values, *own])[:: -1 if knob.setting != "quality" else 1]
    all_places = np.array(knob.places(all_values.tolist()))
    inside = (all_places >= places[0] - 1e-9) & (all_places <= places[-1] + 1e-9)
    if own:  # a bound finer than all that was measured holds, too: it begins with what the finest of these took
        inside |= all_values == min(own[0], *entry["values"])
    at = all_places[inside]
    grids = {
        name: np.array([np.exp(np.interp(at, places, np.log(np.maximum(row, 1e-6)))) for row in entry[name]])
        for name in ("range_bits", "chamfer_m", "rmse_m")
    }
    return all_values[inside], grids


def _allowed(entry: dict[str, Any], codec: str, values: Floats, rmse: Floats, pins: Pins) -> npt.NDArray[np.bool_]:
    """(steps, values) bool, what no automatic choice may exceed left out; the finest value is always there."""
    if entry["knob"] != BOUND:
        fine = rmse <= (SPARSE_RMSE_M if pins.sparse else COARSEST_RMSE_M)
        if pins.value is not None:
            fine = np.zeros_like(fine)
            fine[:, np.abs(values - pins.value).argmin()] = True
    else:
        bound_m = COARSEST_M if pins.bound_m is None else pins.bound_m
        steps = np.array([step_of(value) for value in values])
        fine = np.broadcast_to(steps <= step_of(bound_m), rmse.shape).copy()
    fine[:, -1] |= ~fine.any(axis=1)
    return fine

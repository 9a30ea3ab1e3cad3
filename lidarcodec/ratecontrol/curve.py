"""Operating curves: for each number of bits the best measured working point.

A working point is a step of the lattice of columns, a value of the codec's knob and a number of intensity levels.
`working_points.json` has, for each codec, bits and quality of a grid of points on training drives (made by
`benchmarks/working_points.py`). A curve is made for the settings that the operator left free; pinned settings stay
fixed. Along a curve with more bits, distances, errors of intensity and the step never increase.

>>> curve = operating_curve("riddle", Pins())
>>> bool((np.diff(curve.bits) > 0).all()), bool((np.diff(curve.cost) < 0).all())
(True, True)
>>> {point.step for point in operating_curve("riddle", Pins(step=1)).points}
{1}
"""

from __future__ import annotations

import json
from collections.abc import Sequence
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
"""Returns of a frame of an HDL-64E in a street, with single returns."""
NEXT_STEP: Final = 1.04
"""Steps of `steps_between` are at least this factor apart."""
COARSEST_M: Final = 0.3
"""Largest range error of automatic choices; for a codec without a bound the largest RMSE."""
COARSEST_RMSE_M: Final = 0.2
"""Largest RMSE on training drives for a codec without a bound, because other scenes are rougher."""
SPARSE_RMSE_M: Final = 0.1
"""The same if a reducer chooses returns, because neighbours in the image are then farther apart than in the
measurement."""
INTENSITY_M: Final = 1e-4
"""Weight of a squared error of intensity (of 255), in metres of Chamfer distance, up to INTENSITY_KNEE."""
INTENSITY_KNEE: Final = 18.0
"""RMSE of intensity up to which shades are visible. Above it only bright and dark can be distinguished."""
INTENSITY_BEYOND_M: Final = 4e-4
"""Weight of a step of RMSE just above the knee, in metres; at twice this RMSE the weight is half, and so on."""


class WorkingPoint(NamedTuple):
    """step: every step-th column, or one in so many returns, is sent; value: value of the codec's knob; levels:
    levels of intensity, 256 lossless, 0 none"""

    step: int
    value: float
    levels: int


class Pins(NamedTuple):
    """Pinned values; None: free.

    step: step of the lattice; levels: levels of intensity; bound_m: the error bound, used in full; value: knob of a
    codec without a bound; sparse: whether a reducer chooses the returns, unlike in the measurement of the points
    """

    step: int | None = None
    levels: int | None = None
    bound_m: float | None = None
    value: float | None = None
    purpose: Purpose = "look"
    sparse: bool = False


@dataclass(frozen=True, eq=False)
class Curve:
    """points: with increasing bits. For each point, (N,): `range`, `intensity` and `rest`, in bits per return of the
    original frame; `chamfer_m` and `shades`, the distance in metres and the RMSE of intensity (of 255), both with
    interpolated returns; and `cost`, the loss of quality in metres. The last three never increase."""

    points: tuple[WorkingPoint, ...]
    range: Floats
    intensity: Floats
    rest: Floats
    cost: Floats
    chamfer_m: Floats
    shades: Floats

    @property
    def bits(self) -> Floats:
        """(N,) total bits per return of the original frame."""
        return self.range + self.intensity + self.rest


@lru_cache(maxsize=8)
def _measured(purpose: Purpose = "look") -> dict[str, Any]:
    """Measured points for a purpose, by codec. Other purposes have another measure in place of the Chamfer distance:
    the position error of a car (`localise`), or the distance from objects to the sent returns (`detect`)."""
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
    """Quality of points for a detector, by step and value. A codec without a bound counts like one with the same
    RMSE.
    """
    bounds = np.sqrt(3.0) * np.array(entry["rmse_m"])
    if entry["bounded"]:
        bounds = np.broadcast_to(np.array(entry["values"]), bounds.shape)
    rows = [things["missed_m"][things["steps"].index(step)] for step in entry["steps"]]
    found = [np.interp(at, things["bounds_m"], row) for at, row in zip(bounds, rows, strict=True)]
    worth: list[list[float]] = np.array(found).tolist()
    return worth


def has_curve(codec: str) -> bool:
    """Whether the working points of a codec were measured. `auto` chooses only such codecs."""
    return codec in _measured()


def points_of(codec: str, purpose: Purpose) -> dict[str, Any]:
    """The measured points of a codec. If it was not measured: of the measured codec with the same knob and the most
    bits.

    Rate control begins with them, and corrects them from sent messages.
    """
    found = _measured(purpose)
    if codec in found:
        entry: dict[str, Any] = found[codec]
        return entry
    knob = table.codec(codec).knob
    alike = [entry for entry in found.values() if knob is not None and entry["knob"] == knob.setting]
    if not alike:
        raise SettingsError(f"codec {codec} was not measured with the setting that adjusts its bitrate", "codec")
    return max(alike, key=lambda entry: float(entry["range_bits"][0][-1]))


@lru_cache(maxsize=64)
def operating_curve(codec: str, pins: Pins) -> Curve:
    """The curve of a codec with these pinned values; at least one point.

    If a pinned value was not measured, the nearest one is used, and rate control corrects it. A codec that was not
    measured has the curve of the most similar one (`has_curve`).
    """
    if pins.purpose in ("localise", "detect") and pins.levels is None:
        pins = pins._replace(levels=0)
    thinned = pins.purpose != "localise" or pins.step is None
    entry = points_of(codec, pins.purpose if thinned else "look")
    if pinned_bound(entry, pins.bound_m) is not None:
        entry = with_more_steps(entry)
    values, grids = fine_values(entry, codec, pins.bound_m)
    steps = np.array(entry["steps"])
    levels = np.array(entry["levels"])
    allowed_steps = steps if pins.step is None else steps[[np.abs(np.log(steps / pins.step)).argmin()]]
    if pins.purpose == "archive":
        allowed_steps = allowed_steps[:1]
    allowed_levels = levels if pins.levels is None else levels[[np.abs(levels - pins.levels).argmin()]]
    fine_enough = allowed_values(entry, values, grids["rmse_m"], pins)
    shades = np.array(entry["intensity_rmse"])
    shades[:, levels == 0] = shades.max()  # without intensity the step does not matter
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
    cost = found[6] + missed(found[7])
    kept = chain(found[3] + found[4] + found[5], cost, found[[0, 6, 7]])
    own = pinned_bound(entry, pins.bound_m)
    points = tuple(
        WorkingPoint(
            pins.step or int(step),
            float(value) if own is None else own,
            int(level) if pins.levels is None else pins.levels,
        )
        for step, value, level in found[:3, kept].T
    )
    ranges, intensity, rest, chamfer_m, rmse = found[3:, kept]
    return Curve(points, ranges, intensity, rest, cost[kept], chamfer_m, rmse)


def missed(rmse: Floats) -> Floats:
    """Weights of RMSEs of intensity in metres; same shape."""
    beyond = INTENSITY_KNEE * np.log(np.maximum(rmse / INTENSITY_KNEE, 1.0))
    missed: Floats = INTENSITY_M * np.minimum(rmse, INTENSITY_KNEE) ** 2 + INTENSITY_BEYOND_M * beyond
    return missed


def pinned_bound(entry: dict[str, Any], bound_m: float | None, range_step_m: float = RANGE_STEP_M) -> float | None:
    """The value of the knob of a pinned bound: in whole steps of the range, and at most COARSEST_M, because coarser
    pictures are false. None without one, or another knob."""
    if bound_m is None or entry["knob"] != BOUND:
        return None
    return round((step_of(min(bound_m, COARSEST_M), range_step_m) - 1) // 2 * range_step_m, 4)


def steps_between(steps: Sequence[int]) -> list[int]:
    """The steps, and whole ones between them. Where the bound is pinned only steps change the bits by much, and a
    stream would alternate between two that are far apart.

    >>> steps_between([1, 2, 3, 16, 24])
    [1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 17, 18, 19, 20, 21, 22, 23, 24]
    """
    found = [steps[0]]
    for step in range(steps[0] + 1, steps[-1] + 1):
        if step in steps or step >= NEXT_STEP * found[-1]:
            found.append(step)
    return found


def with_more_steps(entry: dict[str, Any]) -> dict[str, Any]:
    """Measured points with those of `steps_between`, interpolated over the logarithm of the step."""
    steps = steps_between(entry["steps"])
    at, measured = np.log(np.array(steps, float)), np.log(np.array(entry["steps"], float))
    more: dict[str, Any] = {"steps": steps}
    for name in ("range_bits", "rest_bits", "chamfer_m", "rmse_m", "intensity_bits", "intensity_rmse"):
        table_of = np.array(entry[name], float).reshape(len(measured), -1)
        columns = [np.interp(at, measured, column) for column in table_of.T]
        more[name] = np.array(columns).T.reshape(len(steps), *np.shape(entry[name])[1:])
    return {**entry, **more}


def fine_values(entry: dict[str, Any], codec: str, bound_m: float | None) -> tuple[Floats, dict[str, Floats]]:
    """Values of the knob between the measured ones, including a pinned bound, and the grids interpolated at them."""
    knob = table.codec(codec).knob
    assert knob is not None
    places: Floats = np.array(knob.places(entry["values"]))
    bound = pinned_bound(entry, bound_m)
    own = () if bound is None else (bound,)
    all_values = np.unique([*knob.values, *own])[:: -1 if knob.setting != "quality" else 1]
    all_places = np.array(knob.places(all_values.tolist()))
    inside = (all_places >= places[0] - 1e-9) & (all_places <= places[-1] + 1e-9)
    if own:  # a finer bound than all measured ones is allowed: it begins with the bits of the finest measured one
        inside |= all_values == min(own[0], *entry["values"])
    at = all_places[inside]
    grids = {
        name: np.array([np.exp(np.interp(at, places, np.log(np.maximum(row, 1e-6)))) for row in entry[name]])
        for name in ("range_bits", "chamfer_m", "rmse_m")
    }
    return all_values[inside], grids


def allowed_values(entry: dict[str, Any], values: Floats, rmse: Floats, pins: Pins) -> npt.NDArray[np.bool_]:
    """(steps, values) bool, points within the limits of automatic choices; the finest value is always allowed. A pinned
    bound is used in full: a finer one would take bits from columns and intensities, which are not pinned."""
    if entry["knob"] != BOUND:
        fine = rmse <= (SPARSE_RMSE_M if pins.sparse else COARSEST_RMSE_M)
        if pins.value is not None:
            fine = np.zeros_like(fine)
            fine[:, np.abs(values - pins.value).argmin()] = True
    else:
        steps = np.array([step_of(value) for value in values])
        if pins.bound_m is None:
            chosen = steps <= step_of(COARSEST_M)
        else:
            chosen = np.arange(len(values)) == np.abs(np.log(steps / step_of(min(pins.bound_m, COARSEST_M)))).argmin()
        fine = np.broadcast_to(chosen, rmse.shape).copy()
    fine[:, -1] |= ~fine.any(axis=1)
    return fine

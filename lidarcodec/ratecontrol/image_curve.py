"""Operating curves of other sensors than the HDL-64E: its curve, drawn over the directions in which a sensor looks.

Working points were measured on drives with an HDL-64E (`curve.py`). How much of a street a lattice of columns shows
depends on the angle between two columns that are sent, and a return takes the more bits the larger that angle is; so
a lattice of every n-th column counts as that of an HDL-64E with the same angle. A range in coarse steps takes the bits
that a bound of that width takes. Few values of attributes were measured on captures of other sensors
(`benchmarks/attribute_points.py`). What a scene and a sensor take beside that, rate control learns from the messages.

A message has one section for all planes, so bits of attributes count among those of ranges.

>>> curve = image_curve("predictive", Pins(), ImageKind(spacing=2.0, attributes=2, range_step_m=0.008))
>>> bool((np.diff(curve.bits) > 0).all()), bool((np.diff(curve.cost) < 0).all())
(True, True)
>>> max(point.value for point in curve.points) <= COARSEST_M, curve.points[-1].step, curve.points[-1].levels
(True, 1, 256)
"""

from __future__ import annotations

import json
import math
from functools import lru_cache
from importlib.resources import files
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from lidarcodec.codecs import table
from lidarcodec.codecs.rate_knob import BOUND
from lidarcodec.frame import Frame
from lidarcodec.frame_images import layout_of
from lidarcodec.packet_rest import PacketRest
from lidarcodec.ratecontrol.chain import chain
from lidarcodec.ratecontrol.curve import (
    COARSEST_M,
    RETURNS_A_SECOND,
    Curve,
    Pins,
    WorkingPoint,
    allowed_values,
    fine_values,
    missed,
    points_of,
    steps_between,
)
from lidarcodec.sensors.images import QUANTITIES
from lidarcodec.settings import step_of
from lidarcodec.units import AZIMUTH_TURN, RANGE_STEP_M

Floats = npt.NDArray[np.float64]

COLUMNS: Final = 2088
"""Of a turn of an HDL-64E."""
REST_BITS: Final = 0.15
"""Bits of a return beside the planes, before the first message: time stamps and the like."""
TURN_S: Final = 0.1
"""Time of a turn where host times do not say it."""
LONGEST_TURN_S: Final = 2.0
PROBED: Final = 4
"""Levels with which it is tried what the attributes of a sensor take."""
PROBED_BOUND_M: Final = 0.02
"""Bound of the ranges meanwhile."""
PROBED_CODEC: Final = "predictive"
"""Codec meanwhile, in place of one that codes ranges as pictures."""
MOST_ATTRIBUTES: Final = 64.0
BEYOND: Final = 4 / 3
"""A lattice may be wider than the widest that was measured by this factor, and no more: too little would be seen."""


class ImageKind(NamedTuple):
    """What rate control knows of a sensor.

    spacing: angle between two columns, of that of an HDL-64E; attributes: bits that all attributes take, of what one
    takes in the mean of what was measured; returns_per_s: first returns a second
    """

    spacing: float = 1.0
    attributes: float = 1.0
    range_step_m: float = RANGE_STEP_M
    returns_per_s: float = RETURNS_A_SECOND

    @property
    def sparser(self) -> float:
        """Returns of an HDL-64E for one of this sensor."""
        return min(max(RETURNS_A_SECOND / self.returns_per_s, 0.1), 64.0)


def kind_of(frame: Frame, attribute_bits: float | None = None) -> ImageKind:
    """What rate control has to know of the sensor of a frame; the frame is best a whole turn.

    attribute_bits: bits that its attributes take with PROBED levels; None: not known, as the mean of what was measured
    """
    found = layout_of(frame)
    if found is None or frame.width < 2:
        return ImageKind(range_step_m=frame.sensor.range_step_m)
    names = [plane.name for plane in found[1].planes if plane.name in QUANTITIES]
    attributes: float = len(names)
    if attribute_bits is not None and frame.points:
        attributes = min(float(f"{attribute_bits / frame.points / _of_level('bits', PROBED):.2g}"), MOST_ATTRIBUTES)
    swept = int((np.diff(frame.azimuth[0].astype(np.int64)) % AZIMUTH_TURN).sum())
    turns = max(swept / AZIMUTH_TURN, 0.01)
    return ImageKind(
        spacing=round(min(max(COLUMNS * turns / frame.width, 0.1), 64.0), 1),
        attributes=attributes,
        range_step_m=frame.sensor.range_step_m,
        returns_per_s=float(f"{max(frame.points, 1) / seconds_of(frame):.2g}"),
    )


def seconds_of(frame: Frame) -> float:
    """Time in which the sensor made a frame: by the host times of its packets, else by how far it turned."""
    rest = frame.side
    if isinstance(rest, PacketRest) and rest.packets > 1:
        span_s = float(rest.packet_ns[-1] - rest.packet_ns[0]) * 1e-9 * rest.packets / (rest.packets - 1)
        if 0.0 < span_s < LONGEST_TURN_S:
            return span_s
    swept = int((np.diff(frame.azimuth[0].astype(np.int64)) % AZIMUTH_TURN).sum()) if frame.width > 1 else AZIMUTH_TURN
    return TURN_S * max(swept / AZIMUTH_TURN, 0.001)


@lru_cache(maxsize=64)
def image_curve(codec: str, pins: Pins, kind: ImageKind) -> Curve:
    """The curve of a codec around what is pinned, for images of that kind. At least one point."""
    if pins.purpose in ("localise", "detect") and pins.levels is None:
        pins = pins._replace(levels=0)
    chosen = pins.purpose == "localise" and pins.step is None
    entry = points_of(codec, pins.purpose if chosen or pins.purpose != "localise" else "look")
    measured = np.array(entry["steps"], float)
    wider = kind.sparser if chosen else kind.spacing
    if pins.step is not None:
        steps = np.array([pins.step], float)
    elif chosen:  # a localiser needs so many returns, whatever the sensor
        steps = np.unique(np.maximum(np.rint(measured / wider), 1.0))
    else:
        steps = measured if pins.bound_m is None else np.array(steps_between(entry["steps"]), float)
        steps = steps[(steps * wider <= BEYOND * measured[-1]) | (steps == measured[0])]
    if pins.purpose == "archive":
        steps = steps[:1]
    levels = np.array(_attributes()["levels"])
    if pins.levels is not None:
        levels = levels[[np.abs(levels - pins.levels).argmin()]]
    grid = _Grid(entry, codec)
    rows = []
    for step in steps:
        like = np.log(np.clip(step * wider, measured[0], measured[-1]))
        values = grid.values(like, kind, pins)
        seen = like if step > 1 or chosen else 0.0  # no gap is wider than the sensor's own columns
        ranges = grid.range_bits(like, values, kind.range_step_m) * np.exp(like) / step
        chamfer_m = grid.at("chamfer_m", seen, values, kind.range_step_m if chosen else RANGE_STEP_M)
        for level in levels:
            bits = kind.attributes * grid.attribute_bits(like, int(level)) * np.exp(like) / step
            shades = grid.shades(seen, int(level))
            rows += [
                (step, value, level, one + bits, far_m, shades)
                for value, one, far_m in zip(values, ranges, chamfer_m, strict=True)
            ]
    found: Floats = np.array(rows).T
    cost = found[4] + missed(found[5])
    kept = chain(found[3], cost, found[[0, 4, 5]])
    points = tuple(
        WorkingPoint(pins.step or int(step), float(value), int(level) if pins.levels is None else pins.levels)
        for step, value, level in found[:3, kept].T
    )
    none = np.zeros(len(kept))
    return Curve(points, found[3, kept], none, none + REST_BITS, cost[kept], found[4, kept], found[5, kept])


def range_bits(codec: str, kind: ImageKind) -> float:
    """Bits that a range is expected to take where all are sent, with errors up to PROBED_BOUND_M."""
    values = _values(kind.range_step_m, PROBED_BOUND_M)[:1]
    like = float(np.log(max(kind.spacing, 1.0)))
    found = _Grid(points_of(codec, "look"), codec).range_bits(like, values, kind.range_step_m)
    return float(found[0]) * math.exp(like)


class _Grid:
    """What was measured of a codec, between the steps and the values at which it was measured."""

    def __init__(self, entry: dict[str, Any], codec: str) -> None:
        knob = table.codec(codec).knob
        assert knob is not None
        self._codec, self._knob, self._bound = codec, knob, knob.setting == BOUND
        self._entry, self._steps = entry, np.log(np.array(entry["steps"], float))
        self._places: Floats = np.array(knob.places(entry["values"]))
        if self._bound:
            self._places = -np.log(2.0 * (np.array(entry["values"]) / RANGE_STEP_M) + 1.0)

    def values(self, like: float, kind: ImageKind, pins: Pins) -> Floats:
        """(N,) values of the knob to choose among, from the coarsest; a pinned one alone. A quality
        has the same error for every sensor."""
        if self._bound:
            return (
                _values(kind.range_step_m, None)
                if pins.bound_m is None
                else _values(kind.range_step_m, min(pins.bound_m, COARSEST_M))[:1]
            )
        values, grids = fine_values(self._entry, self._codec, None)
        nearest = int(np.abs(self._steps - like).argmin())
        found: Floats = values[allowed_values(self._entry, values, grids["rmse_m"], pins)[nearest]]
        return found

    def at(self, name: str, like: float, values: Floats, range_step_m: float = RANGE_STEP_M) -> Floats:
        """(N,) what was measured at those values, bounds for a sensor with such range steps. like: logarithm of the
        step."""
        places = np.array(self._knob.places(values.tolist()))
        if self._bound:
            places = np.minimum(_places(values, range_step_m), 0.0)
        columns = [np.exp(np.interp(places, self._places, np.log(np.maximum(row, 1e-6)))) for row in self._entry[name]]
        found: Floats = np.array(
            [np.exp(np.interp(like, self._steps, np.log(column))) for column in np.array(columns).T]
        )
        return found

    def range_bits(self, like: float, values: Floats, range_step_m: float) -> Floats:
        """(N,) bits of the ranges and their mask per return of the frame; a bit more for each halving of the step."""
        finer = np.maximum(_places(values, range_step_m), 0.0) / np.log(2.0) if self._bound else np.zeros(len(values))
        mask = np.interp(like, self._steps, self._entry["rest_bits"])
        found: Floats = self.at("range_bits", like, values, range_step_m) + finer * np.exp(-like) + mask
        return found

    def attribute_bits(self, like: float, level: int) -> float:
        """Bits of an attribute of so many levels per return of the frame: neighbours further apart say less."""
        whole = np.array(self._entry["intensity_bits"])[:, -1]
        return _of_level("bits", level) * float(np.interp(like, self._steps, whole) / whole[0])

    def shades(self, like: float, level: int) -> float:
        """RMSE of the intensity: of so many levels, and of what is filled in between the columns."""
        filled = float(np.interp(like, self._steps, np.array(self._entry["intensity_rmse"])[:, -1]))
        return math.hypot(filled, _of_level("rmse", level)) if level else float(np.max(self._entry["intensity_rmse"]))


@lru_cache(maxsize=1)
def _attributes() -> dict[str, list[float]]:
    found: dict[str, list[float]] = json.loads(
        files("lidarcodec.ratecontrol").joinpath("working_points_attributes.json").read_text()
    )
    return found


def _of_level(name: str, level: int) -> float:
    found = _attributes()
    return found[name][found["levels"].index(level)]


def _places(values: Floats, range_step_m: float) -> Floats:
    """Where bounds are on a scale of widths: 0 is the step of an HDL-64E, and coarser ones lie below."""
    places: Floats = -np.log(2.0 * (values + range_step_m / 2) / RANGE_STEP_M)
    return places


def _values(range_step_m: float, bound_m: float | None) -> Floats:
    """(N,) bounds of every step of the sensor, 5 % apart where they are many: from the coarsest to none."""
    most = step_of(COARSEST_M if bound_m is None else bound_m, range_step_m) // 2
    halves = [0]
    while halves[-1] < most:
        halves.append(min(max(halves[-1] + 1, round(halves[-1] * 1.05)), most))
    return np.round(np.array(halves[::-1]) * range_step_m, 4)

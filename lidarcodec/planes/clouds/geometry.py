"""x, y and z of points of a range image, from a range, a direction and the geometry of each row.

    D   = n s                               n the range of a point, s the step in metres
    rho = a D + r,   z = t D + h            a, r, t and h of the row
    phi = (k + d) / U  turns                k the direction of a point, d of the row, U steps of a turn
    x   = rho cos phi - o sin phi,   y = rho sin phi + o cos phi           o of the row

That is exact for sensors whose beams turn round z: Velodyne's vertical and horizontal offsets, Ouster's distance of the
beams from the axis. Everything is IEEE 754 arithmetic of + - * / and rounding alone, in the order written here, so that
every machine computes the same bits; no sine of a library is used.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Numbers = npt.NDArray[np.int64]

SCALES: Final = {
    "along": 2.0**-36,
    "along_m": 2.0**-28,
    "up": 2.0**-36,
    "up_m": 2.0**-28,
    "aside_m": 2.0**-28,
    "turned": 2.0**-28,
}
"""Number of a row in the order of the section -> what one unit of it is worth. Fine enough for float32 at 100 m."""
ANGLES: Final = ((0, 0), (-1, 0), (1, 0), (-1, 1), (1, 1), (-1, 3), (1, 3))
"""Of each: sense and quarters. phi is exact with (0, 0). Else sense times phi, plus so many quarters of a turn, is
what the driver has in radians as float32, from 0 to one turn."""
_TURN: Final = 6.283185307179586
_SIN: Final = (-1 / 6, 1 / 120, -1 / 5040, 1 / 362880, -1 / 39916800, 1 / 6227020800, -1 / 1307674368000)
_COS: Final = (-1 / 2, 1 / 24, -1 / 720, 1 / 40320, -1 / 3628800, 1 / 479001600, -1 / 87178291200)


@dataclass(frozen=True, eq=False)
class Geometry:
    """step_m: s; turn: U; narrow: whether the driver computes in float32; rows: (6, H) int64 in units of SCALES.

    angles: how the driver rounds phi, a place in ANGLES
    """

    step_m: float
    turn: int
    narrow: bool
    angles: int
    rows: Numbers

    def value(self, name: str) -> Floats:
        """(H,) of each row."""
        place = list(SCALES).index(name)
        found: Floats = self.rows[place].astype(np.float64) * SCALES[name]
        return found

    def native(self, left: int, unit: float) -> tuple[float, int, bool, int, Floats, int, float]:
        """As the native core takes it, with the form and the unit of what is left of coordinates."""
        values = np.stack([self.value(name) for name in SCALES])
        return self.step_m, self.turn, self.narrow, self.angles, values, left, unit


class Points(NamedTuple):
    """(N,) each."""

    x: Floats
    y: Floats
    z: Floats


def cosine_sine(turns: Floats) -> tuple[Floats, Floats]:
    """Cosine and sine of angles in turns, within 1e-15."""
    quarter = np.rint(turns * 4.0)
    angle = (turns - quarter * 0.25) * _TURN
    square = angle * angle
    sine = np.full(square.shape, _SIN[-1])
    for factor in (*_SIN[-2::-1], 1.0):
        sine = sine * square + factor
    sine = sine * angle
    cosine = np.full(square.shape, _COS[-1])
    for factor in (*_COS[-2::-1], 1.0):
        cosine = cosine * square + factor
    turned = quarter.astype(np.int64) & 3
    swapped = (turned & 1) == 1
    found_cos, found_sin = np.where(swapped, sine, cosine), np.where(swapped, cosine, sine)
    return (
        np.where((turned == 1) | (turned == 2), -found_cos, found_cos),
        np.where(turned >= 2, -found_sin, found_sin),
    )


def directions(geometry: Geometry, row: Numbers, k: Numbers) -> Floats:
    """(N,) turns, as the driver has them."""
    turns = (k.astype(np.float64) + geometry.value("turned")[row]) / geometry.turn
    sense, quarters = ANGLES[geometry.angles]
    if not sense:
        return turns
    angle = turns * sense + quarters * 0.25
    radians = ((angle - np.floor(angle)) * _TURN).astype(np.float32)
    found: Floats = (radians.astype(np.float64) / _TURN - quarters * 0.25) * sense
    return found


def predicted(geometry: Geometry, row: Numbers, n: Numbers, k: Numbers) -> Points:
    """Points of ranges n and directions k, (N,) each, before they are rounded to float32."""
    cosine, sine = cosine_sine(directions(geometry, row, k))
    if not geometry.narrow:
        distance = n.astype(np.float64) * geometry.step_m
        rho = geometry.value("along")[row] * distance + geometry.value("along_m")[row]
        up = geometry.value("up")[row] * distance + geometry.value("up_m")[row]
        aside = geometry.value("aside_m")[row]
        return Points(rho * cosine - aside * sine, rho * sine + aside * cosine, up)
    single = {name: geometry.value(name).astype(np.float32)[row] for name in SCALES}
    distance_n = n.astype(np.float32) * np.float32(geometry.step_m)
    rho_n = distance_n * single["along"] + single["along_m"]
    up_n = distance_n * single["up"] + single["up_m"]
    cosine_n, sine_n, aside_n = cosine.astype(np.float32), sine.astype(np.float32), single["aside_m"]
    x, y = rho_n * cosine_n - aside_n * sine_n, rho_n * sine_n + aside_n * cosine_n
    return Points(x.astype(np.float64), y.astype(np.float64), up_n.astype(np.float64))


def ordered(values: npt.NDArray[np.float32]) -> Numbers:
    """float32 as whole numbers in the same order; neighbours differ by 1. -0.0 is -1 less than 0.0."""
    bits = values.view(np.int32)
    found: Numbers = (bits ^ ((bits >> 31) & np.int32(0x7FFFFFFF))).astype(np.int64)
    return found


def from_ordered(numbers: Numbers) -> npt.NDArray[np.float32]:
    """The inverse of `ordered`, of numbers of 32 bits."""
    bits = numbers.astype(np.int32)
    found: npt.NDArray[np.float32] = (bits ^ ((bits >> 31) & np.int32(0x7FFFFFFF))).view(np.float32)
    return found

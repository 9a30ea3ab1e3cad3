"""Finds what a driver computed x, y and z from: range step, steps of a turn, and the geometry of each row.

A sensor measures ranges and azimuths in whole steps, so points of a row lie on a lattice in the range and one in the
direction. Found, both are whole numbers again, and what float32 rounding left is a few units in the last place.
Floating point of the encoder is free here: only `Geometry` is sent.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from lidarcodec.planes.clouds.geometry import SCALES, Floats, Geometry, Numbers

STEPS_M: Final = (0.008, 0.005, 0.004, 0.0025, 0.002, 0.001)
HUNDREDTHS: Final = (36000, 72000)
COARSE: Final = (600, 1800, 2000)
"""Whole numbers of hundredths of a degree."""
TURNS: Final = (512, 1024, 2048, 4096, *COARSE, *HUNDREDTHS)
FINE_STEP_M: Final = 2.0**-13
FINE_TURN: Final = 1 << 24
_ON_LATTICE: Final = 0.8
"""Mean resultant length of phases from which on they count as one: 1 if all are equal, near 0 if they are random."""
_SURELY: Final = 0.9999
"""The same of coarse steps: a sensor that fires in finer ones may nearly keep to them."""
_LOOKED_AT: Final = 16_384
"""Points by which a lattice is found."""
_MOST_N: Final = (1 << 20) - 1


class Fit(NamedTuple):
    """The geometry, and (N,) whole numbers of each point: range n and direction k."""

    geometry: Geometry
    n: Numbers
    k: Numbers


def fit(
    xyz: Floats,
    row: Numbers,
    column: Numbers,
    rows: int,
    *,
    known: Numbers | None,
    known_step_m: float,
    step_m: float | None = None,
    fine_turn: int | None = None,
) -> Fit:
    """The geometry of points, (3, N) metres, all with a return, in their cells of a range image.

    known: ranges in steps of known_step_m that the message has anyway
    step_m: the range step to take where it need not be the sensor's, for a bounded error; fine_turn: the steps of a
        turn to take if none are found
    """
    by_row = _Rows(row, rows)
    rho, z = np.hypot(xyz[0], xyz[1]), xyz[2]
    if known is not None:
        step, n = known_step_m, known.astype(np.int64)
    else:
        slope, _ = by_row.line(rho, z)
        distance = rho * np.sqrt(1.0 + slope * slope)[row]
        step, n = _ranges(distance, by_row) if step_m is None else (step_m, np.rint(distance / step_m).astype(np.int64))
    n = np.clip(n, 1, _MOST_N)
    azimuth = np.arctan2(xyz[1], xyz[0])
    aside = np.zeros(rows)
    if _lattice(azimuth, rho, aside[row], by_row) is None:
        aside = _beside_axis(azimuth, rho, column, by_row)
    measured = n * step
    fine = fine_turn or FINE_TURN
    turn, turned, k = _directions(azimuth, rho, aside[row], by_row, fine)
    for _ in range(2):
        if turn not in TURNS:
            break
        left = _nearest(azimuth - (k + turned[row]) * (2 * np.pi / turn))
        slant, _ = by_row.line(1.0 / np.maximum(rho, 0.1), left)
        before, aside = aside, np.where((np.abs(slant) > 1e-4) & (np.abs(slant) < 0.2), slant, 0.0)
        if np.array_equal(before, aside):
            break
        turn, turned, k = _directions(azimuth, rho, aside[row], by_row, fine)
    along, along_m = by_row.line(measured, np.sqrt(np.maximum(rho * rho - (aside * aside)[row], 0.0)))
    up, up_m = by_row.line(measured, z)
    values = {"along": along, "along_m": along_m, "up": up, "up_m": up_m, "aside_m": aside, "turned": turned}
    units = np.stack([np.rint(values[name] / scale) for name, scale in SCALES.items()])
    return Fit(Geometry(step, turn, False, 0, np.clip(units, -(2**52), 2**52).astype(np.int64)), n, k)


class _Rows:
    """Sums over the points of each row."""

    def __init__(self, row: Numbers, rows: int) -> None:
        self.row, self.rows = row, rows
        self.count = np.bincount(row, minlength=rows).astype(np.float64)
        few = np.random.default_rng(1).integers(0, len(row), _LOOKED_AT)
        self.part: Numbers | slice = few if len(row) > _LOOKED_AT else slice(None)

    def sums(self, values: Floats) -> Floats:
        return np.bincount(self.row, values, self.rows).astype(np.float64, copy=False)

    def line(self, x: npt.NDArray[Any], y: npt.NDArray[Any]) -> tuple[Floats, Floats]:
        """Slope and height of the line through the points of each row, by least squares; 0 where there are too few."""
        count = np.maximum(self.count, 1.0)
        mean_x, mean_y = self.sums(x) / count, self.sums(y) / count
        dx, dy = x - mean_x[self.row], y - mean_y[self.row]
        spread = self.sums(dx * dx)
        slope = np.where(spread > 1e-12, self.sums(dx * dy) / np.maximum(spread, 1e-12), 0.0)
        far = np.abs(dy - slope[self.row] * dx)
        limit = 8.0 * np.sqrt(self.sums(far * far) / count)[self.row] + 1e-12
        if (far > limit).any():  # once more without points that lie far off
            near = (far <= limit).astype(np.float64)
            count = np.maximum(self.sums(near), 1.0)
            mean_x, mean_y = self.sums(x * near) / count, self.sums(y * near) / count
            dx, dy = (x - mean_x[self.row]) * near, (y - mean_y[self.row]) * near
            spread = self.sums(dx * dx)
            slope = np.where(spread > 1e-12, self.sums(dx * dy) / np.maximum(spread, 1e-12), 0.0)
        return slope, mean_y - slope * mean_x

    def on_lattice(self, values: Floats, least: float = _ON_LATTICE) -> Floats | None:
        """Phase of each row, (-0.5, 0.5], if nearly all values differ by whole numbers within their row; else None."""
        angle, row = values[self.part] * (2 * np.pi), self.row[self.part]
        cosine, sine = (np.bincount(row, wave, self.rows) for wave in (np.cos(angle), np.sin(angle)))
        count = np.bincount(row, minlength=self.rows)
        enough = count >= 8
        if not enough.any() or np.hypot(cosine, sine)[enough].sum() / count[enough].sum() < least:
            return None
        return np.arctan2(sine, cosine) / (2 * np.pi)


def _ranges(distance: Floats, rows: _Rows) -> tuple[float, Numbers]:
    """The range step of the sensor, or a fine one, and the range of each point in it."""
    for step in STEPS_M:
        phase = rows.on_lattice(distance / step)
        if phase is not None:
            return step, np.rint(distance / step - phase[rows.row]).astype(np.int64)
    return FINE_STEP_M, np.rint(distance / FINE_STEP_M).astype(np.int64)


def _beside_axis(azimuth: Floats, rho: Floats, column: Numbers, rows: _Rows) -> Floats:
    """(H,) metres by which the lasers of each row are beside the axis: nearer points lie in other directions.

    The points of a column share its direction. So directions are fitted by columns, rows, and the inverse of the range.
    """
    near = 1.0 / np.maximum(rho, 1.0)
    aside, offset = np.zeros(rows.rows), np.zeros(rows.rows)
    for _ in range(12):
        turned = azimuth - offset[rows.row] - aside[rows.row] * near
        mean = np.angle(np.bincount(column, np.cos(turned)) + 1j * np.bincount(column, np.sin(turned)))
        slant, more = rows.line(near, _nearest(turned - mean[column]))
        aside, offset = aside + slant, offset + more
    return np.where(np.abs(aside) < 0.2, aside, 0.0)


def _lattice(azimuth: Floats, rho: Floats, aside: Floats, rows: _Rows) -> tuple[int, Floats] | None:
    """Steps of a turn in which all directions are whole numbers, but for an offset of each row; None for none."""
    turns = (azimuth - np.arctan2(aside, rho)) / (2 * np.pi)
    for turn in TURNS:
        phase = rows.on_lattice(turns * turn, _SURELY if turn in COARSE else _ON_LATTICE)
        if phase is not None:
            return turn, phase
    return None


def _directions(azimuth: Floats, rho: Floats, aside: Floats, rows: _Rows, fine: int) -> tuple[int, Floats, Numbers]:
    """Steps of a turn, (H,) offset of each row in them, and the direction of each point."""
    turns = (azimuth - np.arctan2(aside, rho)) / (2 * np.pi)
    found = _lattice(azimuth, rho, aside, rows)
    if found is None:
        return fine, np.zeros(rows.rows), np.rint(turns * fine).astype(np.int64)
    turn, phase = found
    k = np.rint(turns * turn - phase[rows.row])
    _, exact = rows.line(np.zeros(len(k)), turns * turn - k)
    decimal = 1000.0 if turn in HUNDREDTHS else 1000.0 * 360 / turn  # thousandths of a step, or of a degree
    near = np.rint(exact * decimal) / decimal
    exact = np.where(np.abs(exact - near) < 2e-6 * turn / 360, near, exact)  # angles of calibration files are such
    return turn, exact, k.astype(np.int64)


def _nearest(angle: npt.NDArray[np.float64]) -> Floats:
    found: Floats = angle - np.rint(angle / (2 * np.pi)) * (2 * np.pi)
    return found

"""Data augmentation: other units of a sensor, and mirrored scenes.

Every HDL-64E has its own distance and rotation corrections in its table, further errors of some millimetres for each
laser that are not in its table, and its own noise. A frame is changed together with its table, so that its points stay
at the same places.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from lidarcodec.entropy import columns_in_turn
from lidarcodec.frame import Frame
from lidarcodec.sensor_model import CALIBRATION_FIELDS, Calibration, SensorModel
from lidarcodec.units import AZIMUTH_TURN, LASERS

_FIELDS: Final = list(CALIBRATION_FIELDS)
_DISTANCES: Final = ("dist_correction_m", "dist_correction_x_m", "dist_correction_y_m")
_LENGTHS_PER_STEP: Final = 20_000
_SPREADS: Final = (0.0, 25.0, 75.0)
"""Standard deviation of a unit's distance corrections from the published ones, in range steps."""
_MOST_LEVEL: Final = 250
_HIDDEN: Final = (0.0, 2.0, 4.0)
_MOST_TURN: Final = 2
_TURNED: Final = 0.4
_NOISES: Final = (0.0, 0.0, 1.0, 2.5)
_MIRRORED: Final = 0.3

Whole = npt.NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Variation:
    """The changes, each (64,) by hardware laser.

    level:    int, offset of ranges in range steps, which the table contains; hidden: int, offset not in the table
    columns:  int, offset of the laser in columns, which the table contains
    noise:    float, standard deviation of added noise, in range steps
    mirrored: whether left and right are exchanged
    """

    level: Whole
    hidden: Whole
    columns: Whole
    noise: npt.NDArray[np.float64]
    mirrored: bool

    @classmethod
    def drawn(cls, rng: np.random.Generator, *, units: bool) -> Variation:
        """A random variation; without `units` only `mirrored` is random."""
        mirrored = bool(rng.random() < _MIRRORED)
        nothing = np.zeros(LASERS, np.int64)
        if not units:
            return cls(nothing, nothing, nothing, np.zeros(LASERS), mirrored)
        level = np.rint(rng.normal(0, 1, LASERS) * rng.choice(_SPREADS)).clip(-_MOST_LEVEL, _MOST_LEVEL)
        hidden = np.rint(rng.normal(0, 1, LASERS) * rng.choice(_HIDDEN))
        turned = rng.random() < _TURNED
        columns = rng.integers(-_MOST_TURN, _MOST_TURN + 1, LASERS) if turned else nothing
        noise = rng.choice(_NOISES) * rng.uniform(0.6, 1.4, LASERS)
        return cls(level.astype(np.int64), hidden.astype(np.int64), columns, noise, mirrored)

    def of(self, frames: list[Frame], rng: np.random.Generator) -> list[Frame]:
        """Frames of one sensor as this unit would measure them, without packets and poses."""
        if not frames:
            return []
        sensor = frames[0].sensor
        turn = columns_in_turn(frames[0].azimuth) if all(frame.fired.all() for frame in frames) else None
        columns = self.columns if turn else np.zeros(LASERS, np.int64)
        unit = self._unit(sensor, columns, turn or 1)
        lasers = sensor.laser_of_ring
        return [self._seen(frame, unit, lasers, columns, rng) for frame in frames]

    def _unit(self, sensor: SensorModel, columns: Whole, turn: int) -> SensorModel:
        table = sensor.calibration.table.copy()
        for name in _DISTANCES:
            table[_FIELDS.index(name)] -= (self.level * _LENGTHS_PER_STEP).astype(np.int32)
        angle = CALIBRATION_FIELDS["rot_correction_rad"]
        later = np.rint(columns * (2 * np.pi / turn / angle)).astype(np.int32)
        table[_FIELDS.index("rot_correction_rad")] += later
        if self.mirrored:
            for name in ("rot_correction_rad", "horiz_offset_m"):
                table[_FIELDS.index(name)] *= -1
        return replace(sensor, calibration=Calibration(table))

    def _seen(
        self, frame: Frame, unit: SensorModel, lasers: npt.NDArray[np.intp], columns: Whole, rng: np.random.Generator
    ) -> Frame:
        ranges = frame.range.astype(np.float64) + (self.level + self.hidden)[lasers][:, None]
        if self.noise.any():
            ranges += self.noise[lasers][:, None] * rng.normal(size=ranges.shape)
        seen = np.where(frame.valid, np.rint(ranges).clip(1, 65535), 0).astype(np.uint16)
        for row in np.flatnonzero(columns[lasers]):
            seen[row] = _moved(seen[row], int(columns[lasers[row]]))
        azimuth, fired, intensity = frame.azimuth, frame.fired, frame.intensity
        if self.mirrored:
            seen, fired, intensity = seen[:, ::-1], fired[:, ::-1], intensity[:, ::-1]
            azimuth = ((AZIMUTH_TURN - azimuth[:, ::-1].astype(np.int32)) % AZIMUTH_TURN).astype(np.uint16)
        return replace(
            frame,
            range=np.ascontiguousarray(seen),
            intensity=np.ascontiguousarray(intensity),
            azimuth=np.ascontiguousarray(azimuth),
            fired=np.ascontiguousarray(fired),
            sensor=unit,
            side=None,
            keep=None,
            pose=None,
        )


def _moved(row: npt.NDArray[np.uint16], columns: int) -> npt.NDArray[np.uint16]:
    """A row shifted to the right; new cells at its ends have no return."""
    moved = np.zeros_like(row)
    if columns > 0:
        moved[columns:] = row[:-columns]
    else:
        moved[:columns] = row[-columns:]
    return moved

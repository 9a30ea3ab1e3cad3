"""Other units of a sensor, and the world in a mirror: what a network has to bear that its training data do not show.

Every unit of an HDL-64E has distance and rotation corrections of its own, told by its table; what its table does not
tell, some millimetres from laser to laser; and noise of its own. A frame is changed together with its table, so that
its points stay where they are.
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
"""How far distance corrections of a unit differ from the published ones, range steps (standard deviation)."""
_MOST_LEVEL: Final = 250
_HIDDEN: Final = (0.0, 2.0, 4.0)
_MOST_TURN: Final = 2
_TURNED: Final = 0.4
_NOISES: Final = (0.0, 0.0, 1.0, 2.5)
_MIRRORED: Final = 0.3

Whole = npt.NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Variation:
    """What is different; all by hardware laser, (64,).

    level:    int, range steps more that the unit measures, and its table says so; hidden: the same, but it does not
    columns:  int, columns by which the laser looks later, and its table says so
    noise:    float, standard deviation of what is added to each range, range steps
    mirrored: whether left and right change places
    """

    level: Whole
    hidden: Whole
    columns: Whole
    noise: npt.NDArray[np.float64]
    mirrored: bool

    @classmethod
    def drawn(cls, rng: np.random.Generator, *, units: bool) -> Variation:
        """A variation at random; without `units` the sensor stays itself, and only the mirror is tossed for."""
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
        """Frames of one sensor as this unit would have seen them; neither packets nor poses are left."""
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
    """A row moved to the right; what comes in from beyond its ends is no return."""
    moved = np.zeros_like(row)
    if columns > 0:
        moved[columns:] = row[:-columns]
    else:
        moved[:columns] = row[-columns:]
    return moved

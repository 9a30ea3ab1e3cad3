"""What the sensors that send blocks have in common: their layouts, their generic calibration, and points in metres.

For a channel with elevation v, rotation correction rot, vertical and horizontal offset vo and ho, at azimuth a:

    beta = a - rot;  D = step * range + dist_correction
    x = D cos v cos beta + ho sin beta   (forward: where azimuth 0 points)
    y = ho cos beta - D cos v sin beta   (left)
    z = D sin v + vo                     (up)

As in cloud.py for the convention `veloview`: the vertical offset is the height at which the beam crosses the axis and
is not turned by the elevation, whatever the convention of the SensorModel. These sensors correct ranges themselves, so
the two-point correction of an HDL-64E does not occur.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from lidarcodec.errors import CalibrationError, SectionError
from lidarcodec.sensor_model import Calibration, Origin, SensorModel
from lidarcodec.sensors.images import Metres, PacketLayout, Unsigned
from lidarcodec.sensors.models.blocks import BlockLayout
from lidarcodec.units import AZIMUTH_STEP_DEG, AZIMUTH_TURN

Angles = npt.NDArray[np.uint16]


@dataclass(frozen=True, eq=False)
class BlockSensor(ABC):
    """A model of sensor that sends blocks; the model's file fills it in.

    name: as in `--model`; title: for people; short: the title without maker; range_step_m: metres of one range unit;
    layouts: every layout of its packets; generic: nominal calibration, field -> (H,) by channel
    """

    name: str
    title: str
    short: str
    range_step_m: float
    layouts: tuple[BlockLayout, ...]
    generic: Mapping[str, npt.ArrayLike]

    @property
    def per_unit(self) -> bool:
        """Whether each unit comes with a calibration file of its own: not by default."""
        return False

    @cached_property
    def packet_sizes(self) -> frozenset[int]:
        """Sizes of its packets' UDP payloads."""
        return frozenset(layout.packet_bytes for layout in self.layouts)

    def layout_of(self, payload: bytes) -> BlockLayout | None:
        """The layout of a packet, by its size, its constants and its mode bytes; None if it is none of this model."""
        return next((layout for layout in self.layouts if layout.takes(payload)), None)

    def named_layout(self, name: str) -> BlockLayout | None:
        """The layout of that name."""
        return next((layout for layout in self.layouts if layout.name == name), None)

    @cached_property
    def channel_of_row(self) -> npt.NDArray[np.intp]:
        """(H,) hardware channel of each row, from the top beam down."""
        channels = np.array(self.layouts[0].channel_of_row, np.intp)
        channels.flags.writeable = False
        return channels

    @cached_property
    def generic_sensor(self) -> SensorModel:
        """The SensorModel with the nominal calibration of this model, for streams that come without their own."""
        calibration = Calibration.from_values(dict(self.generic))
        return SensorModel(self.title, calibration, "generic", "veloview", self.range_step_m, self.name)

    @abstractmethod
    def calibration_of(self, data: bytes) -> Calibration:
        """Calibration of this model from the bytes of a file.

        Raises CalibrationError if it is no such file, or of a sensor with another number of lasers.
        """

    def calibrated(self, data: bytes, origin: Origin, name: str) -> SensorModel:
        """The SensorModel of the unit that a calibration file describes. name: of the file, for errors.

        Raises CalibrationError if the file is of another kind or of another sensor.
        """
        try:
            calibration = self.calibration_of(data)
        except CalibrationError as error:
            raise CalibrationError(f"calibration {name}: {error}") from error
        return replace(self.generic_sensor, calibration=calibration, origin=origin)

    def xyz(self, sensor: SensorModel, ranges: Unsigned, azimuth: Angles) -> tuple[Metres, Metres, Metres]:
        """x, y, z in metres of ranges (H, W); azimuth: (H, W) or (1, W), 0.01 degree. See the top of this file."""

        def of(name: str) -> Metres:
            return sensor.calibration[name][self.channel_of_row][:, None]

        rot, vert, offset = of("rot_correction_rad"), of("vert_correction_rad"), of("horiz_offset_m")
        cos_rot, sin_rot = np.cos(rot), np.sin(rot)
        cos_a, sin_a = COSINES[azimuth], SINES[azimuth]
        cos_b, sin_b = cos_a * cos_rot + sin_a * sin_rot, sin_a * cos_rot - cos_a * sin_rot
        distance = ranges * self.range_step_m + of("dist_correction_m")
        flat = distance * np.cos(vert)
        z = distance * np.sin(vert) + of("vert_offset_m")
        return flat * cos_b + offset * sin_b, offset * cos_b - flat * sin_b, z


def rows_of(elevations: npt.ArrayLike) -> tuple[int, ...]:
    """Channel of each row for elevations by channel: the highest first, ties in the order of the channels."""
    return tuple(np.argsort(-np.asarray(elevations, np.float64), kind="stable").tolist())


def own_layout(layout: PacketLayout) -> BlockLayout:
    """The layout, as one of packets made of blocks. Raises SectionError for one of another kind of packets."""
    if not isinstance(layout, BlockLayout):
        raise SectionError(f"the layout {layout.name} is not one of packets made of blocks")
    return layout


def _table(function: np.ufunc) -> Metres:
    """Sine or cosine of every azimuth; angles in float32 as velodyne-decoder has them, 0.03 mm at 100 m."""
    angle = np.float32(AZIMUTH_STEP_DEG) * np.arange(AZIMUTH_TURN, dtype=np.float32) * np.float32(np.pi / 180)
    values: Metres = function(angle.astype(np.float64))
    values.flags.writeable = False
    return values


COSINES, SINES = _table(np.cos), _table(np.sin)

"""Ouster OS0, OS1, OS2 and OSDome, with 16 to 128 beams.

What a sensor is (angles of its beams, columns of a turn) it says in its metadata, a JSON, and not in its packets. So a
sensor is made from metadata; one made from bare packets has images but no points.

For a beam with elevation p, azimuth offset o and the distance n of its origin from the axis, measurement id m of M, and
range r in mm, in the lidar's frame:

    e = -2 pi m / M,  a = e - o
    x = (r - n) cos p cos a + bx cos e
    y = (r - n) cos p sin a + bx sin e
    z = (r - n) sin p + bz

(bx, bz) is the origin of the beams in beam_to_lidar_transform, n its length. `lidar_to_sensor_transform` leads to the
sensor's frame: x forward, away from the connector, y left, z up.

Sources: Ouster's sensor documentation, "Lidar range data to sensor XYZ coordinate frame"; ouster-sdk 1.0.1 (XYZLut).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache, cached_property, lru_cache
from typing import Final

import numpy as np
import numpy.typing as npt

from lidarcodec.errors import CalibrationError
from lidarcodec.sensor_model import Calibration, Origin, SensorModel
from lidarcodec.sensors.images import Images, Metres, PacketLayout, Unsigned
from lidarcodec.sensors.models.ouster import bare
from lidarcodec.sensors.models.ouster.fields import FUSA, PIXELS
from lidarcodec.sensors.models.ouster.layouts import ROWS, OusterLayout
from lidarcodec.sensors.models.ouster.metadata import COLUMNS_PER_FRAME, OusterMetadata, read_metadata
from lidarcodec.units import AZIMUTH_TURN

METADATA_URL: Final = "http://SENSOR/api/v1/sensor/metadata"
HALF_TURN: Final = AZIMUTH_TURN // 2
KEPT: Final = 8
"""Sensors of which the metadata is read once."""


@dataclass(frozen=True, eq=False)
class OusterSensor:
    """An Ouster with one layout of packets; metadata is None if only its packets are known."""

    layout: OusterLayout
    metadata: OusterMetadata | None = None

    @cached_property
    def name(self) -> str:
        """`os1-128`; without metadata `ouster-128-rng15_rfl8_nir8`."""
        if self.metadata is not None:
            return self.metadata.model
        return f"ouster-{self.layout.rows}-{self.layout.name}"

    @property
    def title(self) -> str:
        """`Ouster OS-1-128, 1024x10, RNG15_RFL8_NIR8`."""
        if self.metadata is None:
            return f"Ouster with {self.layout.rows} beams, {self.layout.profile}, without metadata"
        return f"Ouster {self.metadata.product}, {self.metadata.lidar_mode}, {self.layout.profile}"

    @property
    def range_step_m(self) -> float:
        """Metres of one range unit: 0.008 with the profiles RNG15, else 0.001."""
        return self.layout.range_step_m

    @property
    def per_unit(self) -> bool:
        """Each Ouster has metadata of its own."""
        return True

    @property
    def packet_sizes(self) -> frozenset[int]:
        """Sizes of its packets' UDP payloads."""
        return frozenset({self.layout.packet_bytes})

    @cached_property
    def generic_sensor(self) -> SensorModel:
        """The SensorModel of a sensor without metadata: all angles are 0, for they are not known."""
        flat = Calibration.from_values({"vert_correction_rad": np.zeros(self.layout.rows)})
        return SensorModel(self.title, flat, "generic", "veloview", self.range_step_m, self.name)

    def calibrated(self, data: bytes, origin: Origin, name: str) -> SensorModel:
        """The SensorModel of the unit that a metadata JSON describes. name: of the file, for errors.

        Raises CalibrationError if the file is none, or of a sensor with other packets.
        """
        try:
            model = model_from(data, origin)
        except CalibrationError as error:
            raise CalibrationError(f"metadata {name}: {error}") from error
        layout = replace(read_metadata(data).layout, turn_columns=self.layout.turn_columns)
        if layout != self.layout:
            raise CalibrationError(f"metadata {name} is of {model.name}, but the packets are of {self.title}")
        return model

    def layout_of(self, payload: bytes) -> OusterLayout | None:
        """The layout if the packet has its size and, without metadata, looks like it; None if it is none of these."""
        if len(payload) != self.layout.packet_bytes:
            return None
        if self.metadata is None:
            return self.layout if bare.layout_of(payload) == self.layout else None
        return self.layout if self.layout.fits(np.frombuffer(payload, np.uint8)[None])[0] else None

    def named_layout(self, name: str) -> OusterLayout | None:
        """The layout if that is its name."""
        return self.layout if name == self.layout.name else None

    def evidence(self, payload: bytes) -> str | None:
        """Why this packet is one of this sensor, as a sentence for people; None if it is not."""
        if self.layout_of(payload) is None:
            return None
        return f"{len(payload)} bytes, {self.layout.columns} columns of {self.layout.rows} pixels: {self.title}"

    def azimuth(self, layout: PacketLayout, images: Images) -> npt.NDArray[np.uint16]:
        """(W,) direction of each column by its measurement id, 0.01 degree, 0 forward, clockwise seen from above.

        Without metadata the columns of a turn are the least mode of an Ouster that has all these measurement ids.
        """
        ids = images.series["measurement_id"].astype(np.int64)
        forward = HALF_TURN
        if self.metadata is None:
            most = int(ids.max(initial=0))
            columns = next((columns for columns in COLUMNS_PER_FRAME if columns > most), COLUMNS_PER_FRAME[-1])
        else:
            columns = self.metadata.columns_per_frame
            rotation = self.metadata.lidar_to_sensor
            forward = round(float(np.degrees(np.arctan2(rotation[1, 0], rotation[0, 0]))) * 100)
        turned = (ids % columns * AZIMUTH_TURN + columns // 2) // columns
        return ((turned - forward) % AZIMUTH_TURN).astype(np.uint16)

    def times_ns(self, layout: PacketLayout, images: Images) -> npt.NDArray[np.int64]:
        """(1, W) int64, ns from the time stamp of the first column of a packet to that of each column."""
        stamps = images.series["time_ns"].astype(np.uint64).reshape(-1, layout.columns)
        return (stamps - stamps[:, :1]).view(np.int64).reshape(1, -1)

    def points(
        self, sensor: SensorModel, layout: PacketLayout, images: Images, plane: str = "range"
    ) -> tuple[Metres, Metres, Metres]:
        """x, y, z in metres of every cell in the sensor's frame, (H, W) float64 each; x forward, y left, z up.

        `lidar_to_sensor_transform` is applied, as ouster-sdk's XYZLut does: the origin is on the axis at the height of
        the sensor's base. All angles are those of the metadata. Raises CalibrationError without metadata.
        """
        metadata = self.metadata
        if metadata is None:
            raise CalibrationError(
                f"points of an Ouster need its metadata: save {METADATA_URL} as NAME.json beside NAME.pcap"
            )
        encoder = images.series["measurement_id"].astype(np.float64) * (-2 * np.pi / metadata.columns_per_frame)
        angles = np.stack([np.cos(encoder), np.sin(encoder), np.ones(len(encoder))])
        origin_x, origin_z = metadata.beam_to_lidar[0, 3], metadata.beam_to_lidar[2, 3]
        along = images.planes[plane] * (self.range_step_m * 1e3) - np.hypot(origin_x, origin_z)
        shift = metadata.lidar_to_sensor @ np.array([origin_x, 0, origin_z, 1])
        points = []
        for axis in range(3):
            turned = metadata.lidar_to_sensor[axis, :3]
            origins = np.array([turned[0] * origin_x, turned[1] * origin_x, shift[axis] - turned[0] * origin_x])
            points.append((along * (self._directions[axis] @ angles) + origins @ angles) * 1e-3)
        return points[0], points[1], points[2]

    @cached_property
    def _directions(self) -> Metres:
        """(3, H, 3): x, y and z of each beam's direction, as factors of cos e, sin e and 1."""
        if self.metadata is None:
            raise CalibrationError("points of this sensor need its metadata, which has the directions of its beams")
        elevation, offset = np.radians(self.metadata.beam_altitude_deg), np.radians(self.metadata.beam_azimuth_deg)
        flat, cos, sin = np.cos(elevation), np.cos(offset), np.sin(offset)
        zero = np.zeros(len(flat))
        in_lidar = np.array(
            [[flat * cos, flat * sin, zero], [-flat * sin, flat * cos, zero], [zero, zero, np.sin(elevation)]]
        )
        turned: Metres = np.einsum("ij,jkh->ihk", self.metadata.lidar_to_sensor[:3, :3], in_lidar)
        return turned


@lru_cache(maxsize=KEPT)
def sensor_from(metadata: bytes) -> OusterSensor:
    """The sensor that metadata describes.

    Raises CalibrationError if it is not that of an Ouster whose packets have a layout here.
    """
    read = read_metadata(metadata)
    return OusterSensor(read.layout, read)


def model_from(metadata: bytes, origin: Origin) -> SensorModel:
    """The SensorModel that metadata describes; the metadata is its `description`.

    Its calibration holds the angles of the beams; what else is needed for points is in the description.
    Raises CalibrationError if it is not that of an Ouster whose packets have a layout here.
    """
    sensor = sensor_from(metadata)
    read = sensor.metadata
    assert read is not None
    calibration = Calibration.from_values(
        {
            "vert_correction_rad": np.radians(read.beam_altitude_deg),
            "rot_correction_rad": np.radians(-read.beam_azimuth_deg),
        }
    )
    return SensorModel(
        sensor.title, calibration, origin, "veloview", sensor.range_step_m, sensor.name, description=bytes(metadata)
    )


def bare_sensor_of(payload: bytes) -> OusterSensor | None:
    """The sensor without metadata that sends such packets; None if the packet does not look like one of an Ouster."""
    layout = bare.layout_of(payload)
    return None if layout is None else bare_sensors()[OusterSensor(layout).name]


@cache
def bare_sensors() -> dict[str, OusterSensor]:
    """Name -> sensor without metadata, of every profile and number of beams."""
    layouts = (OusterLayout(profile, rows, fusa_head=profile == FUSA) for profile in PIXELS for rows in ROWS)
    return {sensor.name: sensor for sensor in map(OusterSensor, layouts)}


def destaggered(image: Unsigned, pixel_shift_by_row: npt.NDArray[np.int64]) -> Unsigned:
    """A copy of a whole turn's (H, W) image in which a column is one direction: each row is moved to the right.

    pixel_shift_by_row: (H,) columns, as in OusterMetadata; what leaves at one side comes in at the other
    """
    rows, columns = image.shape
    source = (np.arange(columns) - pixel_shift_by_row.reshape(rows, 1)) % columns
    moved: Unsigned = np.take_along_axis(image, source, axis=1)
    return moved

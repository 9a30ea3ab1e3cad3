"""What the packets of Velodyne's VLP-16, HDL-32E, VLP-32C and VLS-128 have in common.

    1206 bytes: 12 blocks (flag u16, azimuth u16 in 0.01 degree, 32 units of distance u16 and intensity u8),
    time stamp u32 in us of the hour, return mode u8, model u8 (together the factory bytes); all little endian

    37  strongest return, layout `single`      38  last return, layout `single`
    39  dual return, layout `dual`: block 2n holds the last return, block 2n + 1 the strongest one. So `range` is the
        last return and `range2` the strongest one.

Frame: azimuth 0 is forward (the sensor's own +y), azimuths grow clockwise seen from above: x forward, y left, z up, as
velodyne-decoder gives them. A sensor turns on while its lasers fire one after the other. So each return gets the
azimuth of its block plus what the sensor turned until then at the mean speed of the packet, rounded to 0.01 degree.

Sources: Velodyne's manuals (VLP-16: 63-9243 rev. E; HDL-32E: 63-9277 rev. D) as velodyne-decoder 3.1.0 (BSD-3-Clause)
follows and names them. Arithmetic in float32 and rounding are as there, so that both give the same azimuths.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from lidarcodec.sensor_model import Calibration, SensorModel
from lidarcodec.sensors import db_xml, ros_yaml
from lidarcodec.sensors.images import Images, Metres, PacketLayout
from lidarcodec.sensors.models.block_sensor import Angles, BlockSensor, own_layout
from lidarcodec.sensors.models.blocks import Allowed, BlockLayout
from lidarcodec.units import AZIMUTH_TURN, BLOCKS_PER_PACKET, LASERS_PER_BLOCK, UPPER_FLAG

UNIT = np.dtype([("distance", "<u2"), ("intensity", "u1")])
BLOCK = np.dtype([("flag", "<u2"), ("azimuth", "<u2"), ("units", UNIT, LASERS_PER_BLOCK)])
TAIL = [("time_us", "<u4"), ("mode", "u1"), ("model", "u1")]
PACKET = np.dtype([("blocks", BLOCK, BLOCKS_PER_PACKET), *TAIL])
STRONGEST, LAST, DUAL = 0x37, 0x38, 0x39
MODES = {STRONGEST: "strongest return", LAST: "last return", DUAL: "dual return"}
Seconds = npt.NDArray[np.float32]


def velodyne_layouts(model: int, channel_of_row: tuple[int, ...]) -> tuple[BlockLayout, BlockLayout]:
    """Layouts `single` and `dual` of a model whose blocks all have the flag 0xEEFF."""
    flags = {"blocks.flag": (UPPER_FLAG,) * BLOCKS_PER_PACKET}
    return (
        velodyne_layout("single", PACKET, channel_of_row, model, 1, flags),
        velodyne_layout("dual", PACKET, channel_of_row, model, 2, flags),
    )


def velodyne_layout(
    name: str,
    packet: np.dtype[np.void],
    channel_of_row: tuple[int, ...],
    model: int,
    group: int,
    flags: Mapping[str, Allowed],
) -> BlockLayout:
    """A layout of the Velodyne family; `group` blocks share one azimuth. Dual return if it is named `dual`."""
    constants = {**flags, "model": (model,)}
    dual = name == "dual"
    modes: dict[str, Allowed] = {} if dual else {"mode": (STRONGEST, LAST)}
    if dual:
        constants["mode"] = (DUAL,)
    return BlockLayout(name, packet, channel_of_row, 2 if dual else 1, group, constants, modes)


def vertical_offsets_m(beams_meet_mm: float, elevations_deg: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """(H,) heights at which beams cross the axis, if they meet in a point so many mm from it."""
    return -beams_meet_mm * 1e-3 * np.tan(np.radians(elevations_deg))


@dataclass(frozen=True, eq=False)
class VelodyneSensor(BlockSensor):
    """A Velodyne with 16 or 32 lasers.

    cycle_us: time from a column to the next; shot_us: from a firing to the next; together: lasers that fire at once
    """

    cycle_us: float
    shot_us: float
    together: int

    def calibration_of(self, data: bytes) -> Calibration:
        """Calibration of this model from the bytes of a `db.xml` or ROS `.yaml` file.

        Raises CalibrationError if it is no such file, or of a sensor with another number of lasers.
        """
        xml = data.removeprefix(b"\xef\xbb\xbf").lstrip()[:1] == b"<"
        parse = db_xml.parse if xml else ros_yaml.parse
        return parse(data, len(self.channel_of_row))

    def evidence(self, payload: bytes) -> str | None:
        """Why this packet is one of this model, as a sentence for people; None if it is not."""
        if self.layout_of(payload) is None:
            return None
        return f"{len(payload)} bytes, factory bytes {payload[-2:].hex(' ')}: {self.short}, {MODES[payload[-2]]}"

    def azimuth(self, layout: PacketLayout, images: Images) -> Angles:
        """(W,) rotation position of each column when its first laser fires, 0.01 degree, 0 to 35999, clockwise."""
        azimuths: Angles = self._azimuths(own_layout(layout), images, first=True)[0]
        return azimuths

    def times_ns(self, layout: PacketLayout, images: Images) -> npt.NDArray[np.int64]:
        """(H, W) int64, ns from the packet's time stamp to the firing of each laser."""
        timing = self.timing(own_layout(layout), images).astype(np.float64)[:, self.channel_of_row]
        packets = images.planes["range"].shape[1] // layout.columns
        return np.tile(np.rint(timing.T * 1e9).astype(np.int64), (1, packets))

    def points(
        self, sensor: SensorModel, layout: PacketLayout, images: Images, plane: str = "range"
    ) -> tuple[Metres, Metres, Metres]:
        """x, y, z in metres of every cell, (H, W) float64 each; x forward (azimuth 0), y left, z up."""
        return self.xyz(sensor, images.planes[plane], self._azimuths(own_layout(layout), images))

    def timing(self, layout: BlockLayout, images: Images) -> Seconds:
        """(columns, H) float32, seconds from the packet's time stamp to the firing of each channel."""
        return _timing(layout.columns, len(self.channel_of_row), self.cycle_us, self.shot_us, self.together)

    def turning(self, layout: BlockLayout, images: Images, timing: Seconds) -> Seconds:
        """(P,) float32, speed in 0.01 degree a second: from the packet's first block to its last one."""
        azimuth = images.series["azimuth"].reshape(-1, layout.blocks // layout.group)
        duration = timing[self._first_columns(layout)[-1], 0] - timing[0, 0]
        speed: Seconds = turned(azimuth[:, 0], azimuth[:, -1]).astype(np.float32) / duration
        return speed

    def _first_columns(self, layout: BlockLayout) -> npt.NDArray[np.intp]:
        """First column of each group of blocks."""
        groups = layout.blocks // layout.group
        return np.arange(groups) * (layout.columns // groups)

    def _azimuths(self, layout: BlockLayout, images: Images, *, first: bool = False) -> Angles:
        """(H, W) azimuth of each firing, or (1, W) that of each column's first one."""
        timing = self.timing(layout, images)
        starts = self._first_columns(layout)
        each = layout.columns // len(starts)
        since = timing - np.repeat(timing[starts, 0], each)[:, None]
        since = since[:, :1] if first else since[:, self.channel_of_row]
        block = np.repeat(images.series["azimuth"].astype(np.float32), each).reshape(-1, layout.columns)
        speed = self.turning(layout, images, timing)
        angle = block[:, :, None] + speed[:, None, None] * since
        steps = np.floor((angle + np.float32(AZIMUTH_TURN)).astype(np.float64) + 0.5) % AZIMUTH_TURN
        return np.ascontiguousarray(steps.astype(np.uint16).reshape(-1, since.shape[1]).T)


def turned(before: npt.NDArray[np.unsignedinteger], after: npt.NDArray[np.unsignedinteger]) -> npt.NDArray[np.int64]:
    """Steps of 0.01 degree from an azimuth clockwise to another one, 0 to 35999."""
    return (after.astype(np.int64) - before.astype(np.int64)) % AZIMUTH_TURN


@lru_cache(maxsize=16)
def _timing(columns: int, channels: int, cycle_us: float, shot_us: float, together: int) -> Seconds:
    column, channel = np.arange(columns)[:, None], np.arange(channels)
    timing = (cycle_us * 1e-6 * column + shot_us * 1e-6 * (channel // together)).astype(np.float32)
    timing.flags.writeable = False
    return timing

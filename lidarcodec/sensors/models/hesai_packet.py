"""What the packets of Hesai's Pandar40P, Pandar64, PandarQT and PandarXT have in common.

A head (except for the Pandar40P), blocks, and a tail; all little endian. A unit is distance u16, reflectivity u8 (the
plane `intensity`) and, except for the Pandar40P and 64, one byte more: the plane `confidence`, which some models leave
without a meaning. The range step in the head must be that of the model.

The return mode in the tail says what the blocks hold. In dual modes the blocks 2n and 2n + 1 hold two returns of one
firing: `range` is the first of the two names below, `range2` the other one.

    33 first   34 second   37 strongest   38 last                                             layout `single`
    39 last and strongest   3a first and second   3b last and first (XT; others: first and last)
    3c first and strongest   3e strongest and second strongest                                layout `dual`

Frame: azimuth 0 is forward (the sensor's own +y, opposite to the cable), azimuths grow clockwise seen from above:
x forward, y left, z up. Hesai's own frame has x where ours has -y. A return has the azimuth of its block plus the
azimuth offset of its channel; what the sensor turns between the firings of a column is not corrected.

Source of fields, return modes and frame: tier4/nebula 606ac41f (`hesai_packet.hpp`, `hesai_sensor.hpp`,
`hesai_decoder.hpp`), which follows Hesai's manuals.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from lidarcodec.sensor_model import Calibration, SensorModel
from lidarcodec.sensors import hesai_csv
from lidarcodec.sensors.images import Images, Metres, PacketLayout
from lidarcodec.sensors.models.block_sensor import Angles, BlockSensor, own_layout, rows_of
from lidarcodec.sensors.models.blocks import Allowed, BlockLayout, reserved
from lidarcodec.units import AZIMUTH_TURN

UNIT_3 = np.dtype([("distance", "<u2"), ("intensity", "u1")])
UNIT_4 = np.dtype([("distance", "<u2"), ("intensity", "u1"), ("confidence", "u1")])
Fields = list[tuple[str, str] | tuple[str, type[np.uint8], int]]

START, BLOCK_FLAG = 0xFFEE, 0xEEFF
"""EE FF as u16, and FF EE."""
HEAD_12: Fields = [
    ("start", "<u2"),
    ("protocol", *reserved(4)),
    ("lasers", "u1"),
    ("blocks_sent", "u1"),
    ("first_block", "u1"),
    ("step_mm", "u1"),
    ("returns", "u1"),
    ("flags", "u1"),
]
"""`protocol`: major and minor version, two bytes without a name. `flags`: which optional parts the packet has."""
TAIL_40P: Fields = [
    ("reserved", *reserved(5)),
    ("shutdown", "u1"),
    ("reserved2", *reserved(2)),
    ("motor_speed", "<u2"),
    ("time_us", "<u4"),
    ("mode", "u1"),
    ("factory", "u1"),
    ("date", *reserved(6)),
]
"""Of the Pandar40P and 64. `shutdown`: flag of a shutdown for heat. `date`: year, month, day, hour, minute, second."""
TAIL_XT: Fields = [
    ("reserved", *reserved(10)),
    ("mode", "u1"),
    ("motor_speed", "<u2"),
    ("date", *reserved(6)),
    ("time_us", "<u4"),
    ("factory", "u1"),
]
SEQUENCE: Fields = [("udp_sequence", "<u4")]

SINGLE: Allowed = (0x33, 0x34, 0x37, 0x38)
DUAL: Allowed = (0x39, 0x3A, 0x3B, 0x3C, 0x3E)
Offsets = npt.NDArray[np.int64]


def hesai_layouts(
    head: Fields,
    blocks: int,
    unit: np.dtype[np.void],
    tails: Sequence[Fields],
    elevations_deg: Sequence[float],
    step_mm: int = 4,
    checksums: Mapping[str, tuple[int, int]] | None = None,
) -> tuple[BlockLayout, ...]:
    """Layouts `single` and `dual`, and `single_2`, `dual_2` for a second tail.

    elevations_deg: of each channel; step_mm: of ranges. Without a head, each block begins with a flag.
    """
    channels = len(elevations_deg)
    constants: dict[str, Allowed] = {"blocks.flag": (BLOCK_FLAG,) * blocks}
    if head:
        constants = {"start": (START,), "lasers": (channels,), "blocks_sent": (blocks,), "step_mm": (step_mm,)}
    block = np.dtype([*([] if head else [("flag", "<u2")]), ("azimuth", "<u2"), ("units", unit, channels)])
    rows = rows_of(elevations_deg)
    layouts = []
    for end, tail in zip(("", "_2"), tails, strict=False):
        packet = np.dtype([*head, ("blocks", block, blocks), *tail])
        for name, modes, returns in (("single", SINGLE, 1), ("dual", DUAL, 2)):
            mode = {"mode": modes}
            layouts.append(BlockLayout(name + end, packet, rows, returns, returns, constants, mode, checksums or {}))
    return tuple(layouts)


@dataclass(frozen=True, eq=False)
class HesaiSensor(BlockSensor):
    """A Hesai sensor.

    cycle_ns: time from a column to the next; anchor_ns: from the packet's time stamp to its last column, or to its
    first one if `anchor_is_first`; channel_ns: (H,) ns from a column to the firing of each channel
    """

    cycle_ns: float
    anchor_ns: int
    channel_ns: Sequence[int]
    anchor_is_first: bool = False

    @property
    def per_unit(self) -> bool:
        """Each Hesai unit comes with an angle correction file."""
        return True

    def calibration_of(self, data: bytes) -> Calibration:
        """Calibration of this model from the bytes of Hesai's angle correction `.csv`.

        Raises CalibrationError if it is no such file, or of a sensor with another number of channels.
        """
        return hesai_csv.parse(data, len(self.channel_of_row))

    def evidence(self, payload: bytes) -> str | None:
        """Why this packet is one of this model, as a sentence for people; None if it is not."""
        layout = self.layout_of(payload)
        if layout is None:
            return None
        mode = int(np.frombuffer(payload, layout.packet)["mode"][0])
        returns = "dual return" if layout.returns == 2 else "single return"
        begins = f"{len(payload)} bytes that begin with {payload[:2].hex(' ')}"
        sent = f"{layout.blocks} blocks of {layout.rows} channels"
        return f"{begins}, {sent}, return mode {mode:02x}: {self.short}, {returns}"

    def azimuth(self, layout: PacketLayout, images: Images) -> Angles:
        """(W,) rotation position of each column, 0.01 degree, 0 to 35999, clockwise."""
        azimuths: Angles = (images.series["azimuth"] % AZIMUTH_TURN).astype(np.uint16)
        return azimuths

    def times_ns(self, layout: PacketLayout, images: Images) -> Offsets:
        """(H, W) int64, ns from the packet's time stamp to the firing of each channel (negative: before it)."""
        packets = images.planes["range"].shape[1] // layout.columns
        return np.tile(self.column_ns(layout), packets) + self.firing_ns(own_layout(layout), images)

    def column_ns(self, layout: PacketLayout) -> Offsets:
        """(columns,) int64, ns from the packet's time stamp to each column, rounded down."""
        columns = np.arange(layout.columns) - (0 if self.anchor_is_first else layout.columns - 1)
        times: Offsets = self.anchor_ns + np.floor(self.cycle_ns * columns).astype(np.int64)
        return times

    def firing_ns(self, layout: BlockLayout, images: Images) -> Offsets:
        """(H, W) or (H, 1), ns from the start of a column to the firing of each channel, in the order of rows."""
        return np.array(self.channel_ns, np.int64)[self.channel_of_row][:, None]

    def points(
        self, sensor: SensorModel, layout: PacketLayout, images: Images, plane: str = "range"
    ) -> tuple[Metres, Metres, Metres]:
        """x, y, z in metres of every cell, (H, W) float64 each; x forward (azimuth 0), y left, z up."""
        return self.xyz(sensor, images.planes[plane], self.azimuth(layout, images)[None])


def angles(elevations_deg: npt.ArrayLike, azimuths_deg: npt.ArrayLike) -> dict[str, npt.NDArray[np.float64]]:
    """Calibration values for elevations and azimuth offsets by channel.

    Hesai adds the offset to the azimuth, a Calibration subtracts its rotation correction.
    """
    return {"vert_correction_rad": np.radians(elevations_deg), "rot_correction_rad": -np.radians(azimuths_deg)}

"""Velodyne VLS-128, sold as Alpha Prime: 128 lasers, eight of which fire at once.

Four blocks, flags 0xEEFF, 0xDDFF, 0xCCFF and 0xBBFF, are one firing of all lasers (32 each). With one return a packet
has three columns. With two it has one: each block is sent twice, the last return and then the strongest one, and four
blocks follow that mean nothing; they are kept as the series `padding`.

The speed is that between this packet and the one before it; the first packet of the images takes that of the second.
A firing of eight lasers takes 2.89 us, with firmware before 5.2.3 8/3 us: packets that come 153 to 167 us apart (a
third of that with two returns) are of the latter.

Sources: VLS-128 user manual (padding: p. 57, as tier4/nebula names it; elevations, azimuth offsets, firing times), as
velodyne-decoder 3.1.0 has them, and so both firing times and their limit; vertical offsets as there: 58.63 mm, the
distance of the beams' common point from the axis, times the tangent of the elevation downwards.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lidarcodec.sensors.images import Images
from lidarcodec.sensors.models.block_sensor import rows_of
from lidarcodec.sensors.models.blocks import BlockLayout, reserved
from lidarcodec.sensors.models.velodyne_packet import (
    BLOCK,
    PACKET,
    TAIL,
    Seconds,
    VelodyneSensor,
    turned,
    velodyne_layout,
    vertical_offsets_m,
)

ELEVATIONS_DEG = (
    *(-11.742, -1.99, 3.4, -5.29, -0.78, 4.61, -4.08, 1.31, -6.5, -1.11, 4.28, -4.41, 0.1, 6.48, -3.2, 2.19),
    *(-3.86, 1.53, -9.244, -1.77, 2.74, -5.95, -0.56, 4.83, -2.98, 2.41, -6.28, -0.89, 3.62, -5.07, 0.32, 7.58),
    *(-0.34, 5.18, -3.64, 1.75, -25, -2.43, 2.96, -5.73, 0.54, 9.7, -2.76, 2.63, -7.65, -1.55, 3.84, -4.85),
    *(3.18, -5.51, -0.12, 5.73, -4.3, 1.09, -16.042, -2.21, 4.06, -4.63, 0.76, 15, -3.42, 1.97, -6.85, -1.33),
    *(-5.62, -0.23, 5.43, -3.53, 0.98, -19.582, -2.32, 3.07, -4.74, 0.65, 11.75, -2.65, 1.86, -7.15, -1.44, 3.95),
    *(-2.1, 3.29, -5.4, -0.01, 4.5, -4.19, 1.2, -13.565, -1.22, 4.17, -4.52, 0.87, 6.08, -3.31, 2.08, -6.65),
    *(1.42, -10.346, -1.88, 3.51, -6.06, -0.67, 4.72, -3.97, 2.3, -6.39, -1, 4.39, -5.18, 0.21, 6.98, -3.09),
    *(4.98, -3.75, 1.64, -8.352, -2.54, 2.85, -5.84, -0.45, 8.43, -2.87, 2.52, -6.17, -1.66, 3.73, -4.96, 0.43),
)
ROTATIONS_DEG = (-6.354, -4.548, -2.732, -0.911, 0.911, 2.732, 4.548, 6.354) * 16

FLAGS = (0xEEFF, 0xDDFF, 0xCCFF, 0xBBFF)
DUAL_FLAGS = tuple(flag for flag in FLAGS for _return in range(2))
PADDED_PACKET = np.dtype([("blocks", BLOCK, len(DUAL_FLAGS)), ("padding", *reserved(4 * BLOCK.itemsize)), *TAIL])
ROWS = rows_of(ELEVATIONS_DEG)
MODEL = 0xA1

SHOT_US, EARLY_SHOT_US = 2.89, 8 / 3
EARLIEST_US, LIMIT_US = 153, 167
"""Times between two packets of three columns that tell the early firmware."""
SHOTS_PER_COLUMN = 20
"""Sixteen shots and as much time again as four of them: two after every eighth."""
HOUR_STAMP_US = 7
"""The time stamp is that of the fourth shot, so the first one comes before it."""


@dataclass(frozen=True, eq=False)
class Vls128(VelodyneSensor):
    """The VLS-128: its speed and its firing times depend on the packets before."""

    def timing(self, layout: BlockLayout, images: Images) -> Seconds:
        """(columns, H) float32, seconds from the packet's time stamp to the firing of each channel."""
        column, channel = np.arange(layout.columns)[:, None], np.arange(len(self.channel_of_row))
        shots = SHOTS_PER_COLUMN * column + channel // 8 + 2 * (channel // 64)
        timing = (shots * (SHOT_US * 1e-6) - HOUR_STAMP_US * 1e-6).astype(np.float32)
        between = np.diff(images.series["time_us"].astype(np.int64))
        early = len(between) > 0 and EARLIEST_US <= np.median(between) * 3 / layout.columns < LIMIT_US
        return timing * np.float32(EARLY_SHOT_US / SHOT_US) if early else timing

    def turning(self, layout: BlockLayout, images: Images, timing: Seconds) -> Seconds:
        """(P,) float32, speed in 0.01 degree a second: from the packet before to this one.

        A speed of more than 1.8 times the median is a gap in the stream: it is replaced by the median.
        """
        azimuth = images.series["azimuth"].reshape(-1, layout.columns)
        cycle = np.float32(timing[0, 32] - timing[0, 0]) / 4 * SHOTS_PER_COLUMN
        if layout.columns > 1:
            cycle = timing[1, 0] - timing[0, 0]
        speed = np.zeros(len(azimuth), np.float32)
        speed[1:] = turned(azimuth[:-1, 0], azimuth[1:, 0]).astype(np.float32) / np.float32(cycle * layout.columns)
        if len(speed) > 1:
            median = np.median(speed[1:])
            speed = np.where(speed > np.float32(1.8) * median, median, speed)
            speed[0] = speed[1]
        elif layout.columns > 1:
            speed = turned(azimuth[:, 0], azimuth[:, 1]).astype(np.float32) / cycle
        return speed


SENSOR = Vls128(
    name="vls128",
    title="Velodyne VLS-128 (Alpha Prime)",
    short="VLS-128",
    range_step_m=0.004,
    layouts=(
        velodyne_layout("single", PACKET, ROWS, MODEL, 4, {"blocks.flag": FLAGS * 3}),
        velodyne_layout("dual", PADDED_PACKET, ROWS, MODEL, 8, {"blocks.flag": DUAL_FLAGS}),
    ),
    generic={
        "vert_correction_rad": np.radians(ELEVATIONS_DEG),
        "rot_correction_rad": np.radians(ROTATIONS_DEG),
        "vert_offset_m": vertical_offsets_m(58.63, ELEVATIONS_DEG),
    },
    cycle_us=SHOTS_PER_COLUMN * SHOT_US,
    shot_us=SHOT_US,
    together=8,
)

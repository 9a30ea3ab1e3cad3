"""Velodyne VLP-16, sold as Puck and Puck LITE, and Puck Hi-Res: 16 lasers.

A block holds two firings of all lasers, so a packet has 24 columns with one return and 12 with two. The Puck Hi-Res
differs in its elevations and its model byte.

Sources: VLP-16 user manual 63-9243 rev. E (elevations, firing times); envelope drawing 86-0129 rev. A (vertical offsets
of the Puck Hi-Res). Vertical offsets of the VLP-16 as in velodyne-decoder 3.1.0: 41.91 mm, the distance of the beams'
common point from the axis, times the tangent of the elevation downwards.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lidarcodec.sensors.models.block_sensor import rows_of
from lidarcodec.sensors.models.velodyne_packet import VelodyneSensor, velodyne_layouts, vertical_offsets_m

ELEVATIONS_DEG = (-15, 1, -13, 3, -11, 5, -9, 7, -7, 9, -5, 11, -3, 13, -1, 15)
HIRES_ELEVATIONS_DEG = (
    *(-10, 0.667, -8.667, 2, -7.333, 3.333, -6, 4.667),
    *(-4.667, 6, -3.333, 7.333, -2, 8.667, -0.667, 10),
)
HIRES_VERTICAL_OFFSETS_MM = (7.4, -0.9, 6.5, -1.8, 5.5, -2.7, 4.6, -3.7, 3.7, -4.6, 2.7, -5.5, 1.8, -6.5, 0.9, -7.4)

SENSOR = VelodyneSensor(
    name="vlp16",
    title="Velodyne VLP-16 (Puck, Puck LITE)",
    short="VLP-16",
    range_step_m=0.002,
    layouts=velodyne_layouts(0x22, rows_of(ELEVATIONS_DEG)),
    generic={
        "vert_correction_rad": np.radians(ELEVATIONS_DEG),
        "vert_offset_m": vertical_offsets_m(41.91, ELEVATIONS_DEG),
    },
    cycle_us=55.296,
    shot_us=2.304,
    together=1,
)
HIRES = replace(
    SENSOR,
    name="puck_hires",
    title="Velodyne Puck Hi-Res (VLP-16 Hi-Res)",
    short="Puck Hi-Res",
    layouts=velodyne_layouts(0x24, rows_of(HIRES_ELEVATIONS_DEG)),
    generic={
        "vert_correction_rad": np.radians(HIRES_ELEVATIONS_DEG),
        "vert_offset_m": np.divide(HIRES_VERTICAL_OFFSETS_MM, 1e3),
    },
)

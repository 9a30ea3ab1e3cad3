"""Velodyne VLP-32C, sold as Ultra Puck: 32 lasers, two of which fire at once; a block is a column.

Sources: VLP-32C user manual (elevations, azimuth offsets, firing times), as velodyne-decoder 3.1.0 has them; vertical
offsets as there: 42.4 mm, the distance of the beams' common point from the axis, times the tangent of the elevation
downwards.
"""

from __future__ import annotations

import numpy as np

from lidarcodec.sensors.models.block_sensor import rows_of
from lidarcodec.sensors.models.velodyne_packet import VelodyneSensor, velodyne_layouts, vertical_offsets_m

ELEVATIONS_DEG = (
    *(-25.0, -1.0, -1.667, -15.639, -11.31, 0.0, -0.667, -8.843, -7.254, 0.333, -0.333, -6.148, -5.333, 1.333, 0.667),
    *(-4.0, -4.667, 1.667, 1.0, -3.667, -3.333, 3.333, 2.333, -2.667, -3.0, 7.0, 4.667, -2.333, -2.0, 15.0, 10.333),
    -1.333,
)
ROTATIONS_DEG = (
    *(-1.4, 4.2, -1.4, 1.4, -1.4, 1.4, -4.2, 1.4, -1.4, 4.2, -1.4, 1.4, -4.2, 1.4, -4.2, 1.4),
    *(-1.4, 4.2, -1.4, 4.2, -4.2, 1.4, -1.4, 1.4, -1.4, 1.4, -1.4, 4.2, -4.2, 1.4, -1.4, 1.4),
)

SENSOR = VelodyneSensor(
    name="vlp32c",
    title="Velodyne VLP-32C (Ultra Puck)",
    short="VLP-32C",
    range_step_m=0.004,
    layouts=velodyne_layouts(0x28, rows_of(ELEVATIONS_DEG)),
    generic={
        "vert_correction_rad": np.radians(ELEVATIONS_DEG),
        "rot_correction_rad": np.radians(ROTATIONS_DEG),
        "vert_offset_m": vertical_offsets_m(42.4, ELEVATIONS_DEG),
    },
    cycle_us=55.296,
    shot_us=2.304,
    together=2,
)

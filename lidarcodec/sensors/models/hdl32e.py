"""Velodyne HDL-32E: 32 lasers, which fire one after the other; a block is a column.

Sources: HDL-32E application note 63-9277 rev. D (packets, return modes and firing times; elevations); vertical offsets:
envelope drawing 86-0106 rev. B. Packets of firmware before 2.2.20 (2016) have no factory bytes and are not recognised.
"""

from __future__ import annotations

import numpy as np

from lidarcodec.sensors.models.block_sensor import rows_of
from lidarcodec.sensors.models.velodyne_packet import VelodyneSensor, velodyne_layouts

ELEVATIONS_DEG = (
    *(-30.67, -9.33, -29.33, -8.0, -28.0, -6.67, -26.67, -5.33, -25.33, -4.0, -24.0, -2.67, -22.67, -1.33, -21.33, 0.0),
    *(-20.0, 1.33, -18.67, 2.67, -17.33, 4.0, -16.0, 5.33, -14.67, 6.67, -13.33, 8.0, -12.0, 9.33, -10.67, 10.67),
)
VERTICAL_OFFSETS_MM = (
    *(17.17, 4.76, 16.27, 4.07, 15.4, 3.38, 14.54, 2.7, 13.71, 2.02, 12.89, 1.35, 12.09, 0.67, 11.31, 0.0),
    *(10.54, -0.67, 9.78, -1.35, 9.04, -2.02, 8.3, -2.7, 7.58, -3.38, 6.86, -4.07, 6.15, -4.76, 5.45, -5.45),
)

SENSOR = VelodyneSensor(
    name="hdl32e",
    title="Velodyne HDL-32E",
    short="HDL-32E",
    range_step_m=0.002,
    layouts=velodyne_layouts(0x21, rows_of(ELEVATIONS_DEG)),
    generic={"vert_correction_rad": np.radians(ELEVATIONS_DEG), "vert_offset_m": np.divide(VERTICAL_OFFSETS_MM, 1e3)},
    cycle_us=46.08,
    shot_us=1.152,
    together=1,
)

"""Hesai PandarXT32: 32 channels.

A head of twelve bytes, eight blocks of 32 units, a tail with the number of the packet. The last byte of a unit is its
confidence.

Source of packet and firing times: tier4/nebula 606ac41f (`pandar_xt32.hpp`), after Hesai's manual. The angles are the
nominal ones; each sensor has its own, which its `.csv` gives.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from lidarcodec.sensors.models.block_sensor import rows_of
from lidarcodec.sensors.models.blocks import BlockLayout
from lidarcodec.sensors.models.hesai_packet import (
    HEAD_12,
    SEQUENCE,
    TAIL_XT,
    UNIT_4,
    HesaiSensor,
    angles,
    head_of,
    hesai_layouts,
)

ELEVATIONS_DEG = tuple(range(15, -17, -1))
AZIMUTHS_DEG = (0.0,) * len(ELEVATIONS_DEG)
FIRING_NS = tuple(368 + 1_512 * channel for channel in range(len(ELEVATIONS_DEG)))
BLOCKS = 8
LAYOUTS = hesai_layouts(
    HEAD_12,
    [],
    BLOCKS,
    len(ELEVATIONS_DEG),
    UNIT_4,
    (TAIL_XT + SEQUENCE,),
    rows_of(ELEVATIONS_DEG),
    head_of(len(ELEVATIONS_DEG), BLOCKS, 4),
)


def column_ns(layout: BlockLayout) -> npt.ArrayLike:
    """(columns,) ns from the packet's time stamp to each column; the last one is the nearest to it."""
    return 5_632 - 50_000 * np.arange(layout.columns)[::-1]


SENSOR = HesaiSensor(
    name="xt32",
    title="Hesai PandarXT32",
    short="XT32",
    range_step_m=0.004,
    layouts=LAYOUTS,
    generic=angles(ELEVATIONS_DEG, AZIMUTHS_DEG),
    column_ns=column_ns,
    channel_ns=FIRING_NS,
)

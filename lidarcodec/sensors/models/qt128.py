"""Hesai QT128 (QT128C2X): 128 channels, 96 of which fire in a column.

A head of twelve bytes, two blocks of 128 units, checksum, functional safety, tail, and 32 bytes of cyber security
(without them: `single_2`, `dual_2`). With one return a packet has two columns, of loops 1 and 2. With two returns it
has one, of loop 1 if the last bit of `mode_flag` is set. The checksum of the functional safety is kept as it is;
those of blocks and tail are computed.

Source of packet, angles and firing times: tier4/nebula 606ac41f (`pandar_qt128.hpp`, `PandarQT128.csv`), after Hesai's
manual. It puts the first block after the second one in time; here they follow each other as their azimuths do.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from lidarcodec.sensors.images import Images
from lidarcodec.sensors.models.block_sensor import rows_of
from lidarcodec.sensors.models.blocks import BlockLayout, reserved
from lidarcodec.sensors.models.hesai_packet import (
    HEAD_12,
    SEQUENCE,
    UNIT_4,
    Fields,
    HesaiSensor,
    Offsets,
    angles,
    head_of,
    hesai_layouts,
)

ELEVATIONS_DEG = (
    *(-52.6268, -51.0281, -49.515, -48.0739, -46.6947, -45.3688, -44.0897, -42.8519, -41.6507, -40.4823, -39.3433),
    *(-38.2309, -37.1426, -36.0764, -35.0302, -34.0024, -32.9916, -31.9963, -31.0154, -30.0479, -29.0926, -28.1488),
    *(-27.2157, -26.2924, -25.3784, -24.4729, -23.5754, -22.6854, -21.8024, -20.9259, -20.0555, -19.1908, -18.3314),
    *(-17.4769, -16.6271, -15.7815, -14.9399, -14.1021, -13.2677, -12.4365, -11.6082, -10.7826, -9.9595, -9.1387),
    *(-8.3199, -7.503, -6.6878, -5.8739, -5.0614, -4.2499, -3.4394, -2.6296, -1.8204, -1.0115, -0.2029, 0.6057),
    *(1.4144, 2.2235, 3.033, 3.8431, 4.6541, 5.466, 6.2792, 7.0937, 7.9098, 8.7276, 9.5474, 10.3693, 11.1936),
    *(12.0205, 12.8502, 13.6829, 14.519, 15.3587, 16.2022, 17.0499, 17.902, 18.7589, 19.6209, 20.4884, 21.3618),
    *(22.2415, 23.1279, 24.0216, 24.9229, 25.8326, 26.7512, 27.6793, 28.6176, 29.567, 30.5283, 31.5024, 32.4903),
    *(33.4931, 34.5122, 35.549, 19.1908, 20.0555, 20.9259, 21.8024, 22.6854, 23.5754, 24.4729, 25.3784, 26.2924),
    *(27.2157, 28.1488, 29.0926, 30.0479, 31.0154, 31.9963, 32.9916, 34.0024, 35.0302, 36.0764, 37.1426, 38.2309),
    *(39.3433, 40.4823, 41.6507, 42.8519, 44.0897, 45.3688, 46.6947, 48.0739, 49.515, 51.0281, 52.6268),
)
AZIMUTHS_DEG = (
    *(10.1083, 9.7195, 9.3843, 9.0914, 8.8329, 8.6026, 8.3959, 8.2092, 8.0396, 7.8848, 7.7429, 7.6123, 7.4918),
    *(7.3802, 7.2766, 7.1802, 7.0903, 7.0064, 6.9278, 6.8543, 6.7853, 6.7205, 6.6597, 6.6024, 6.5486, 6.4979, 6.4501),
    *(6.4052, 6.3628, 6.323, 6.2855, 6.2502, -6.217, -6.1858, -6.1566, -6.1292, -6.1036, -6.0797, -6.0574, -6.0367),
    *(-6.0175, -5.9998, -5.9836, -5.9688, -5.9553, -5.9432, -5.9267, -5.9229, -5.9146, -5.9076, -5.9019, -5.8974),
    *(-5.894, -5.8919, -5.891, -5.8913, -5.8928, -5.8955, -5.8995, -5.9046, -5.911, -5.9186, -5.9275, -5.9376),
    *(5.9491, 5.9618, 5.976, 5.9915, 6.0085, 6.0269, 6.0468, 6.0683, 6.0914, 6.1161, 6.1426, 6.1709, 6.2011, 6.2333),
    *(6.2675, 6.3039, 6.3425, 6.3836, 6.4272, 6.4736, 6.5227, 6.575, 6.6305, 6.6895, 6.7523, 6.8191, 6.8903, 6.9663),
    *(7.0475, 7.1343, 7.2273, 7.3272, -6.2502, -6.2855, -6.323, -6.3628, -6.4052, -6.4501, -6.4979, -6.5486, -6.6024),
    *(-6.6597, -6.7205, -6.7853, -6.8543, -6.9278, -7.0064, -7.0903, -7.1802, -7.2766, -7.3802, -7.4918, -7.6123),
    *(-7.7429, -7.8848, -8.0396, -8.2092, -8.3959, -8.6026, -8.8329, -9.0914, -9.3843, -9.7195, -10.1083),
)
LOOP_1_NS = (
    *(0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 27656, 53000),
    *(2312, 78344, 81512, 5480, 56168, 30824, 33992, 59336, 8648, 84680, 87848, 11816, 62504, 37160, 40328, 65672),
    *(14984, 91016, 94184, 18152, 68840, 43496, 46664, 72008, 21320, 97352, 100520, 24488, 75176, 49832, 1456, 77488),
    *(26800, 52144, 55312, 29968, 80656, 4624, 7792, 83824, 33136, 58480, 61648, 36304, 86992, 10960, 14128, 90160),
    *(39472, 64816, 67984, 42640, 93328, 17296, 20464, 96496, 45808, 71152, 74320, 48976, 99664, 23632, 25944, 51288),
    *(600, 76632, 79800, 3768, 54456, 29112, 32280, 57624, 6936, 82968, 86136, 10104, 60792, 35448, 38616, 63960),
    *(13272, 89304, 92472, 16440, 67128, 41784, 44952, 70296, 19608, 95640, 98808, 22776, 73464, 48120),
)
LOOP_2_NS = (
    *(2312, 78344, 27656, 53000, 56168, 30824, 81512, 5480, 8648, 84680, 33992, 59336, 62504, 37160, 87848, 11816),
    *(14984, 91016, 40328, 65672, 68840, 43496, 94184, 18152, 21320, 97352, 46664, 72008, 75176, 49832, 100520),
    *(24488, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 600),
    *(76632, 25944, 51288, 54456, 29112, 79800, 3768, 6936, 82968, 32280, 57624, 60792, 35448, 86136, 10104, 13272),
    *(89304, 38616, 63960, 67128, 41784, 92472, 16440, 19608, 95640, 44952, 70296, 73464, 48120, 98808, 22776, 26800),
    *(52144, 1456, 77488, 80656, 4624, 55312, 29968, 33136, 58480, 7792, 83824, 86992, 10960, 61648, 36304, 39472),
    *(64816, 14128, 90160, 93328, 17296, 67984, 42640, 45808, 71152, 20464, 96496, 99664, 23632, 74320, 48976),
)
BLOCKS = 2
TAIL: Fields = [
    ("crc_body", "<u4"),
    ("safety", *reserved(13)),
    ("crc_safety", "<u4"),
    ("reserved", *reserved(5)),
    ("mode_flag", "u1"),
    ("reserved2", *reserved(6)),
    ("mode", "u1"),
    ("motor_speed", "<u2"),
    ("date", *reserved(6)),
    ("time_us", "<u4"),
    ("factory", "u1"),
    *SEQUENCE,
    ("crc_tail", "<u4"),
]
SECURITY: Fields = [("security", *reserved(32))]
LAYOUTS = hesai_layouts(
    HEAD_12,
    [],
    BLOCKS,
    len(ELEVATIONS_DEG),
    UNIT_4,
    (TAIL + SECURITY, TAIL),
    rows_of(ELEVATIONS_DEG),
    head_of(len(ELEVATIONS_DEG), BLOCKS, 4),
    {"crc_body": (12, 1040), "crc_tail": (1061, 1091)},
)


def column_ns(layout: BlockLayout) -> npt.ArrayLike:
    """(columns,) ns from the packet's time stamp to each column."""
    return 9_000 + 111_110 * np.arange(layout.columns)


@dataclass(frozen=True, eq=False)
class Qt128(HesaiSensor):
    """The QT128: the times of its channels depend on the loop."""

    def firing_ns(self, layout: BlockLayout, images: Images) -> Offsets:
        """(H, W), ns from the start of a column to the firing of each channel; 0 for channels that do not fire."""
        loops = np.array((LOOP_2_NS, LOOP_1_NS), np.int64)[:, self.channel_of_row]
        flags = images.series["mode_flag"] & 1
        first = flags if layout.columns == 1 else np.tile(np.array((1, 0), np.uint8), len(flags))
        firing: Offsets = loops[first].T
        return firing


SENSOR = Qt128(
    name="qt128",
    title="Hesai QT128 (QT128C2X)",
    short="QT128",
    range_step_m=0.004,
    layouts=LAYOUTS,
    generic=angles(ELEVATIONS_DEG, AZIMUTHS_DEG),
    column_ns=column_ns,
    channel_ns=LOOP_1_NS,
)

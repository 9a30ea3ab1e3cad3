"""Hesai PandarQT (QT64): 64 channels.

A head of twelve bytes, four blocks of 64 units, a tail with the number of the packet. Without it: `single_2`, `dual_2`.
The plane `confidence`, the last byte of a unit, has no documented meaning.

Source of packet, angles and firing times: tier4/nebula 606ac41f (`pandar_qt64.hpp`, `PandarQT64.csv`), after Hesai's
manual. It has 12960 ns for channel 56, between 127540 and 132050 of its neighbours: here that is 129600.
"""

from __future__ import annotations

from lidarcodec.sensors.models.blocks import reserved
from lidarcodec.sensors.models.hesai_packet import (
    HEAD_12,
    SEQUENCE,
    UNIT_4,
    Fields,
    HesaiSensor,
    angles,
    hesai_layouts,
)

ELEVATIONS_DEG = (
    *(-52.121, -49.785, -47.577, -45.477, -43.465, -41.528, -39.653, -37.831, -36.055, -34.32, -32.619, -30.95),
    *(-29.308, -27.69, -26.094, -24.517, -22.964, -21.42, -19.889, -18.372, -16.865, -15.368, -13.88, -12.399),
    *(-10.925, -9.457, -7.994, -6.535, -5.079, -3.626, -2.175, -0.725, 0.725, 2.175, 3.626, 5.079, 6.534, 7.993),
    *(9.456, 10.923, 12.397, 13.877, 15.365, 16.861, 18.368, 19.885, 21.415, 22.959, 24.524, 26.101, 27.697, 29.315),
    *(30.957, 32.627, 34.328, 36.064, 37.84, 39.662, 41.537, 43.475, 45.487, 47.587, 49.795, 52.133),
)
AZIMUTHS_DEG = (
    *(8.736, 8.314, 7.964, 7.669, 7.417, 7.198, 7.007, 6.838, 6.688, 6.554, 6.434, 6.326, 6.228, 6.14, 6.059, 5.987),
    *(-5.27, -5.216, -5.167, -5.123, -5.083, -5.047, -5.016, -4.988, -4.963, -4.942, -4.924, -4.91, -4.898, -4.889),
    *(-4.884, -4.881, 5.493, 5.496, 5.502, 5.512, 5.525, 5.541, 5.561, 5.584, 5.611, 5.642, 5.676, 5.716, 5.759),
    *(5.808, 5.862, 5.921, -5.33, -5.396, -5.469, -5.55, -5.64, -5.74, -5.85, -5.974, -6.113, -6.269, -6.447, -6.651),
    *(-6.887, -7.163, -7.493, -7.892),
)
FIRING_NS = (
    *(12310, 14370, 16430, 18490, 20540, 22600, 24660, 26710, 29160, 31220, 33280, 35340, 37390, 39450, 41500, 43560),
    *(46610, 48670, 50730, 52780, 54840, 56900, 58950, 61010, 63450, 65520, 67580, 69630, 71690, 73740, 75800, 77860),
    *(80900, 82970, 85020, 87080, 89140, 91190, 93250, 95300, 97750, 99820, 101870, 103930, 105980, 108040, 110100),
    *(112150, 115200, 117260, 119320, 121380, 123430, 125490, 127540, 129600, 132050, 134110, 136170, 138220, 140280),
    *(142340, 144390, 146450),
)
TAIL: Fields = [
    ("reserved", *reserved(10)),
    ("motor_speed", "<u2"),
    ("time_us", "<u4"),
    ("mode", "u1"),
    ("factory", "u1"),
    ("date", *reserved(6)),
]

SENSOR = HesaiSensor(
    name="qt64",
    title="Hesai PandarQT (QT64)",
    short="QT64",
    range_step_m=0.004,
    layouts=hesai_layouts(HEAD_12, 4, UNIT_4, (TAIL + SEQUENCE, TAIL), ELEVATIONS_DEG),
    generic=angles(ELEVATIONS_DEG, AZIMUTHS_DEG),
    cycle_ns=500_000 / 3,
    anchor_ns=25_710,
    anchor_is_first=True,
    channel_ns=FIRING_NS,
)

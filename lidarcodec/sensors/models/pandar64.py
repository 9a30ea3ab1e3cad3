"""Hesai Pandar64: 64 channels.

A head of eight bytes and six blocks of 64 units. Newer firmware adds the number of the packet at the end (layouts
`single` and `dual`; without it `single_2`, `dual_2`).

Source of packet, angles and firing times: tier4/nebula 606ac41f (`pandar_64.hpp`, `Pandar64.csv`), after Hesai's
manual.
"""

from __future__ import annotations

from lidarcodec.sensors.models.blocks import reserved
from lidarcodec.sensors.models.hesai_packet import (
    SEQUENCE,
    TAIL_40P,
    UNIT_3,
    Fields,
    HesaiSensor,
    angles,
    hesai_layouts,
)

ELEVATIONS_DEG = (
    *(14.9, 11.05, 8.077, 5.075, 3.058, 2.046, 1.878, 1.706, 1.54, 1.369, 1.202, 1.031, 0.864, 0.693, 0.526, 0.355),
    *(0.187, 0.018, -0.151, -0.319, -0.49, -0.657, -0.827, -0.995, -1.166, -1.333, -1.504, -1.67, -1.842, -2.01),
    *(-2.18, -2.347, -2.518, -2.682, -2.855, -3.022, -3.192, -3.357, -3.53, -3.694, -3.866, -4.032, -4.203, -4.367),
    *(-4.54, -4.702, -4.874, -5.039, -5.211, -5.373, -5.547, -5.708, -5.88, -6.043, -7.045, -8.041, -9.042, -10.027),
    *(-11.014, -11.988, -12.956, -13.912, -18.871, -24.879),
)
AZIMUTHS_DEG = (
    *(-1.042, -1.042, -1.042, -1.042, -1.042, -1.042, 1.042, 3.125, 5.208, -5.208, -3.125, -1.042, 1.042, 3.125),
    *(5.208, -5.208, -3.125, -1.042, 1.042, 3.125, 5.208, -5.208, -3.125, -1.042, 1.042, 3.125, 5.208, -5.208),
    *(-3.125, -1.042, 1.042, 3.125, 5.208, -5.208, -3.125, -1.042, 1.042, 3.125, 5.208, -5.208, -3.125, -1.042),
    *(1.042, 3.125, 5.208, -5.208, -3.125, -1.042, 1.042, 3.125, 5.208, -5.208, -3.125, -1.042, -1.042, -1.042),
    *(-1.042, -1.042, -1.042, -1.042, -1.042, -1.042, -1.042, -1.042),
)
FIRING_NS = (
    *(-23180, -21876, -20572, -19268, -17964, -16660, -11444, -46796, -7532, -36956, -50732, -54668, -40892, -44828),
    *(-31052, -34988, -48764, -52700, -38924, -42860, -29084, -33020, -46796, -25148, -36956, -50732, -27116, -40892),
    *(-44828, -31052, -34988, -48764, -25148, -38924, -42860, -29084, -33020, -52700, -6228, -54668, -15356, -27116),
    *(-10140, -23180, -4924, -21876, -14052, -17964, -8836, -19268, -3620, -20572, -12748, -16660, -7532, -11444),
    *(-6228, -15356, -10140, -4924, -3620, -14052, -8836, -12748),
)
HEAD: Fields = [
    ("start", "<u2"),
    ("lasers", "u1"),
    ("blocks_sent", "u1"),
    ("head_reserved", "u1"),
    ("step_mm", "u1"),
    ("head_reserved2", *reserved(2)),
]

SENSOR = HesaiSensor(
    name="pandar64",
    title="Hesai Pandar64",
    short="Pandar64",
    range_step_m=0.004,
    layouts=hesai_layouts(HEAD, 6, UNIT_3, (TAIL_40P + SEQUENCE, TAIL_40P), ELEVATIONS_DEG),
    generic=angles(ELEVATIONS_DEG, AZIMUTHS_DEG),
    cycle_ns=55_560,
    anchor_ns=-42_580,
    channel_ns=FIRING_NS,
)

"""Hesai Pandar40P: 40 channels.

Ten blocks of 40 units, each with the flag FF EE, and no head. Newer firmware adds the number of the packet at the end
(layouts `single_2`, `dual_2`).

Source of packet, angles and firing times: tier4/nebula 606ac41f (`pandar_40.hpp`, `Pandar40P.csv`), after Hesai's
manual.
"""

from __future__ import annotations

from lidarcodec.sensors.models.hesai_packet import SEQUENCE, TAIL_40P, UNIT_3, HesaiSensor, angles, hesai_layouts

ELEVATIONS_DEG = (
    *(14.794, 10.944, 7.971, 4.969, 2.952, 1.94, 1.6, 1.263, 0.925, 0.587, 0.249, -0.088, -0.425, -0.763, -1.101),
    *(-1.439, -1.776, -2.116, -2.453, -2.788, -3.128, -3.463, -3.8, -4.138, -4.473, -4.808, -5.145, -5.479, -5.814),
    *(-6.149, -7.151, -8.147, -9.148, -10.133, -11.12, -12.094, -13.062, -14.018, -18.977, -24.985),
)
AZIMUTHS_DEG = (
    *(-1.042, -1.042, -1.042, -1.042, -1.042, -1.042, 3.125, -5.208, -1.042, 3.125, -5.208, -1.042, 3.125, -5.208),
    *(-1.042, 3.125, -5.208, -1.042, 3.125, -5.208, -1.042, 3.125, -5.208, -1.042, 3.125, -5.208, -1.042, 3.125),
    *(-5.208, -1.042, -1.042, -1.042, -1.042, -1.042, -1.042, -1.042, -1.042, -1.042, -1.042, -1.042),
)
FIRING_NS = (
    *(-42220, -28470, -16040, -3620, -45490, -31740, -47460, -54670, -20620, -33710, -40910, -8190, -20620, -27160),
    *(-50730, -8190, -14740, -36980, -45490, -52700, -23890, -31740, -38950, -11470, -18650, -25190, -48760, -6230),
    *(-12770, -35010, -21920, -9500, -43520, -29770, -17350, -4920, -42220, -28470, -16040, -3620),
)

SENSOR = HesaiSensor(
    name="pandar40p",
    title="Hesai Pandar40P",
    short="Pandar40P",
    range_step_m=0.004,
    layouts=hesai_layouts([], 10, UNIT_3, (TAIL_40P, TAIL_40P + SEQUENCE), ELEVATIONS_DEG),
    generic=angles(ELEVATIONS_DEG, AZIMUTHS_DEG),
    cycle_ns=55_560,
    anchor_ns=-28_580,
    channel_ns=FIRING_NS,
)

"""Hesai PandarXT16, XT32 and XT-32M (XT32M, XT32M2X): 16 and 32 channels.

A head of twelve bytes, blocks with a unit for each channel, a tail with the number of the packet. The last byte of a
unit is its confidence. Packets with three returns, which the XT-32M can send, are not recognised. Two channels of the
XT-32M, n and n + 16, fire at once.

Source of packets and firing times: tier4/nebula 606ac41f (`pandar_xt16.hpp`, `pandar_xt32.hpp`, `pandar_xt32m.hpp`),
after Hesai's manuals. It counts the times of one and two returns of the XT-32M as if a packet had eight blocks; here
they are counted from the last of six, as it does for three returns. The angles are the nominal ones; each sensor has
its own, which its `.csv` gives.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lidarcodec.sensors.models.hesai_packet import HEAD_12, SEQUENCE, TAIL_XT, UNIT_4, HesaiSensor, hesai_layouts


def _xt(
    name: str, title: str, elevations_deg: Sequence[float], blocks: int, step_mm: int, channel_ns: Sequence[int]
) -> HesaiSensor:
    return HesaiSensor(
        name=name,
        title=title,
        short=name.upper(),
        range_step_m=step_mm / 1000,
        layouts=hesai_layouts(HEAD_12, blocks, UNIT_4, (TAIL_XT + SEQUENCE,), elevations_deg, step_mm),
        generic={"vert_correction_rad": np.radians(elevations_deg)},
        cycle_ns=50_000,
        anchor_ns=5_632,
        channel_ns=channel_ns,
    )


XT16 = _xt("xt16", "Hesai PandarXT16", range(15, -16, -2), 8, 4, range(368, 368 + 16 * 3_024, 3_024))
XT32 = _xt("xt32", "Hesai PandarXT32", range(15, -17, -1), 8, 4, range(368, 368 + 32 * 1_512, 1_512))
XT32M = _xt(
    name="xt32m",
    title="Hesai PandarXT-32M (XT32M2X)",
    elevations_deg=np.round(19.5 - 1.3 * np.arange(32), 1).tolist(),
    blocks=6,
    step_mm=5,
    channel_ns=2 * [*range(368, 368 + 16 * 2_888, 2_888)],
)

"""The layout of an Ouster's packet without metadata: by its size, its headers and, where two fit, its pixels.

2304, 4352, 8448 and 16640 bytes are each the size of two or three layouts, and the headers of their columns lie in the
same places. The head for functional safety has a serial number where the standard one has reserved bytes. With a
standard head only RNG19_RFL8_SIG16_NIR16_DUAL has a byte of 0 in every 16: it is the reflectivity where pixels are of 4
bytes. If all of these are 0 there, hardly any pixel has a range; DUAL has signal and near infrared nearly always.
"""

from __future__ import annotations

from functools import cache
from typing import Final

import numpy as np

from lidarcodec.sensors.images import Bytes
from lidarcodec.sensors.models.ouster.fields import FUSA, LEGACY, PIXELS
from lidarcodec.sensors.models.ouster.layouts import ROWS, OusterLayout

LIDAR_PACKET: Final = 1
"""Packet type of packets with ranges."""
MAX_MEASUREMENT_ID: Final = 4095
ENCODER_TURN: Final = 90_112
"""Encoder steps of a turn."""
MAX_PACKET_NS: Final = 1_000_000_000
"""Most time between the first and the last column of a packet; 64 columns of the slowest mode take 25 ms."""
LEGACY_STATUS: Final = (0, 0xFFFF_FFFF)
DUAL: Final = "RNG19_RFL8_SIG16_NIR16_DUAL"


@cache
def layouts_of_size(packet_bytes: int) -> tuple[OusterLayout, ...]:
    """Every layout whose packets of 16 columns have that size."""
    layouts = (OusterLayout(profile, rows, fusa_head=profile == FUSA) for profile in PIXELS for rows in ROWS)
    return tuple(layout for layout in layouts if layout.packet_bytes == packet_bytes)


def layout_of(payload: bytes) -> OusterLayout | None:
    """The layout of a packet of 16 columns; None for other bytes, such as the 48 of an IMU packet."""
    packet = np.frombuffer(payload, np.uint8)[None]
    likely = [layout for layout in layouts_of_size(len(payload)) if is_likely(layout, packet)]
    if len(likely) > 1:
        dual = [layout for layout in likely if layout.profile == DUAL]
        likely = dual if dual and _has_signal(packet) else [layout for layout in likely if layout.profile != DUAL]
    return likely[0] if likely else None


def is_likely(layout: OusterLayout, packet: Bytes) -> bool:
    """Whether the head and the columns of a packet, (1, packet_bytes), hold what an Ouster sends."""
    if not layout.fits(packet)[0]:
        return False
    series = layout.numbers(packet)
    ids, times = series["measurement_id"].astype(np.int64), series["time_ns"]
    sent = times[times > 0]
    if (np.diff(ids) != 1).any() or ids[-1] > MAX_MEASUREMENT_ID:
        return False
    if sent.size and int(sent.max()) - int(sent.min()) > MAX_PACKET_NS:
        return False
    if layout.profile == LEGACY:
        same_frame = (series["frame_id"] == series["frame_id"][0]).all()
        known = np.isin(series["status"], LEGACY_STATUS).all()
        return bool(same_frame and known and (series["encoder"] < ENCODER_TURN).all())
    if series["packet_type"][0] != LIDAR_PACKET or (series["status"] > 1).any():
        return False
    return layout.fusa_head == bool(packet[0, 13:16].any())


def _has_signal(packet: Bytes) -> bool:
    """Whether most pixels, taken as those of DUAL with 16 bytes each, have a signal or near infrared.

    If pixels have 4 bytes, the bytes looked at are the ranges of two pixels in four.
    """
    columns = packet[0, 32:-32].reshape(16, -1)
    words = columns[:, 12:].reshape(-1, 4, 4)
    signal, light = words[:, 2, :2].any(axis=1), words[:, 3, :2].any(axis=1)
    return bool(max(signal.mean(), light.mean()) > 0.5)

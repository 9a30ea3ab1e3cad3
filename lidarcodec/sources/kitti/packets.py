"""Firings of consecutive turns -> one continuous stream of packets, as the sensor would have sent it.

A packet holds six firings, an upper and a lower block each. Leftover firings wait for the next turn. The last packet is
padded with firings without returns. KITTI has no time stamps or status bytes, so these are made: the end of the
packet's last firing in microseconds past the hour, and the types H M S D N Y G in turn by the same clock.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from lidarcodec.packet import Packet
from lidarcodec.sensors import PACKET_DTYPE, RETURN_DTYPE
from lidarcodec.sources.kitti.inversion import Firings
from lidarcodec.units import (
    AZIMUTH_TURN,
    FIRINGS_PER_PACKET,
    HOUR_US,
    LASERS,
    LASERS_PER_BLOCK,
    LOWER_FLAG,
    PACKET_BYTES,
    UPPER_FLAG,
)

FIRING_NS: Final = 48_000
PADDING_STEP: Final = 18
FIRING_DTYPE: Final = np.dtype([("azimuth", "<u2"), ("over_ns", "<i8"), ("returns", RETURN_DTYPE, (LASERS,))])
STATUS_TYPES: Final = np.frombuffer(b"HMSDNYG", np.uint8)


class FiringPacker:
    """Packs firings; holds up to five of them until the next turn."""

    def __init__(self) -> None:
        self._waiting: npt.NDArray[np.void] = np.zeros(0, FIRING_DTYPE)
        self._sent = 0

    def push(self, firings: Firings, start_ns: int, end_ns: int) -> list[Packet]:
        """Add the firings of a turn between two host times; returns the packets that became full."""
        count = len(firings.azimuth)
        more = np.zeros(count, FIRING_DTYPE)
        more["azimuth"] = firings.azimuth
        more["returns"]["distance"], more["returns"]["intensity"] = firings.range, firings.intensity
        more["over_ns"] = start_ns + (end_ns - start_ns) * np.arange(1, count + 1, dtype=np.int64) // max(count, 1)
        self._waiting = np.concatenate([self._waiting, more])
        return self._take(len(self._waiting) // FIRINGS_PER_PACKET)

    def finish(self) -> list[Packet]:
        """The last packet, padded with firings without returns; none if no firing waits."""
        missing = -len(self._waiting) % FIRINGS_PER_PACKET
        if not missing:
            return []
        steps, last = np.arange(1, missing + 1), self._waiting[-1]
        empty = np.zeros(missing, FIRING_DTYPE)
        empty["azimuth"] = (int(last["azimuth"]) + PADDING_STEP * steps) % AZIMUTH_TURN
        empty["over_ns"] = int(last["over_ns"]) + FIRING_NS * steps
        self._waiting = np.concatenate([self._waiting, empty])
        return self._take(1)

    def _take(self, count: int) -> list[Packet]:
        """The first `count` packets of the waiting firings."""
        firings = self._waiting[: count * FIRINGS_PER_PACKET].reshape(count, FIRINGS_PER_PACKET)
        self._waiting = self._waiting[count * FIRINGS_PER_PACKET :]
        stamps_ns = firings["over_ns"][:, -1] // 1000 * 1000
        packets = np.zeros(count, PACKET_DTYPE)
        blocks = packets["blocks"]
        blocks["flag"] = [UPPER_FLAG, LOWER_FLAG] * FIRINGS_PER_PACKET
        blocks["azimuth"] = np.repeat(firings["azimuth"], 2, axis=1)
        blocks["returns"] = firings["returns"].reshape(count, 2 * FIRINGS_PER_PACKET, LASERS_PER_BLOCK)
        packets["gps_us"] = stamps_ns // 1000 % HOUR_US
        packets["status_type"], packets["status_value"] = _status(stamps_ns, self._sent)
        self._sent += count
        data = packets.tobytes()
        return [
            Packet(data[k * PACKET_BYTES : (k + 1) * PACKET_BYTES], stamp) for k, stamp in enumerate(stamps_ns.tolist())
        ]


def _status(stamps_ns: npt.NDArray[np.int64], sent: int) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.int64]]:
    """Status types and values of packets at these times, `sent` packets after the first."""
    seconds = stamps_ns // 1_000_000_000
    days = seconds.astype("M8[s]").astype("M8[D]")
    months = days.astype("M8[M]")
    values = np.stack(
        [
            seconds // 3600 % 24,
            seconds // 60 % 60,
            seconds % 60,
            (days - months).astype(np.int64) + 1,
            months.astype(np.int64) % 12 + 1,
            (months.astype("M8[Y]").astype(np.int64) + 1970) % 100,
            np.zeros(len(seconds), np.int64),
        ]
    )
    kind = (sent + np.arange(len(seconds))) % len(STATUS_TYPES)
    return STATUS_TYPES[kind], values[kind, np.arange(len(seconds))]

"""What a recording holds: an MCAP file (mcap.dev) with one channel of messages, of raw packets, or of both.

| encoding             | topic                                      | data of an MCAP message                    |
|----------------------|--------------------------------------------|--------------------------------------------|
| `lidarcodec`         | `lidarcodec/v1/{vehicle}/{sensor}/frame`   | one message as `wire.pack` gives it        |
| `lidarcodec.packets` | `lidarcodec/v1/{vehicle}/{sensor}/packets` | count u32, stamps in ns i64, payloads 1206 |
| `protobuf`           | `lidarcodec/v1/{vehicle}/{sensor}/points`  | `foxglove.PointCloud`: what a message decodes to |
| `protobuf`           | `lidarcodec/v1/{vehicle}/{sensor}/pose`    | `foxglove.FrameTransform`: where the sensor was |

The last two are for people with a viewer, and only there if asked for; nothing of ours reads them.

The MCAP log time is the stamp of the (first) frame or packet, the sequence its frame index modulo 2^32.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Final

import numpy as np

from lidarcodec.errors import PacketError, SectionError
from lidarcodec.packet import Packet
from lidarcodec.units import PACKET_BYTES

MESSAGE_ENCODING: Final = "lidarcodec"
PACKET_ENCODING: Final = "lidarcodec.packets"
METADATA_NAME: Final = "lidarcodec"
"""Name of the MCAP metadata record: format, version, vehicle, sensor and the settings as JSON."""
MAX_BATCH: Final = 16384
"""Packets in a batch, at most: 20 MB."""

_COUNT: Final = struct.Struct("<I")


def topic(vehicle: str, sensor: str, encoding: str) -> str:
    """Topic of a sensor's channel of that encoding; for messages it is their Zenoh key."""
    return f"lidarcodec/v1/{vehicle}/{sensor}/{'packets' if encoding == PACKET_ENCODING else 'frame'}"


def cloud_topics(vehicle: str, sensor: str) -> tuple[str, str]:
    """Topics of the clouds and of the poses of a sensor, for viewers."""
    return f"lidarcodec/v1/{vehicle}/{sensor}/points", f"lidarcodec/v1/{vehicle}/{sensor}/pose"


def pack_batch(packets: Sequence[Packet]) -> bytes:
    """Bytes of a batch of packets.

    Raises PacketError for a payload that has not 1206 bytes, SectionError for no packet or more than MAX_BATCH.
    """
    if not 1 <= len(packets) <= MAX_BATCH:
        raise SectionError(f"a batch of {len(packets)} packets: 1 to {MAX_BATCH} are possible")
    for packet in packets:
        if len(packet.payload) != PACKET_BYTES:
            raise PacketError(f"a payload of {len(packet.payload)} bytes, not {PACKET_BYTES}")
    stamps = np.array([packet.stamp_ns for packet in packets], "<i8").tobytes()
    return _COUNT.pack(len(packets)) + stamps + b"".join(packet.payload for packet in packets)


def unpack_batch(data: bytes) -> list[Packet]:
    """Packets of a batch.

    Raises SectionError.
    """
    count = _COUNT.unpack_from(data)[0] if len(data) >= _COUNT.size else 0
    if not 1 <= count <= MAX_BATCH or len(data) != _COUNT.size + count * (8 + PACKET_BYTES):
        raise SectionError(f"a batch of {count} packets in {len(data)} bytes")
    at = _COUNT.size + 8 * count
    stamps = np.frombuffer(data[_COUNT.size : at], "<i8").tolist()
    return [Packet(data[at + n * PACKET_BYTES : at + (n + 1) * PACKET_BYTES], stamp) for n, stamp in enumerate(stamps)]

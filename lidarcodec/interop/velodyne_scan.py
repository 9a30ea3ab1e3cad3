"""`velodyne_msgs/VelodyneScan` to packets and back, byte for byte, stamps included.

The header has the time of the last packet, as the ROS driver writes it. Its packets are 1216 bytes apart: a time of
eight bytes, the 1206 bytes that the sensor sent, and two that align the next one.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from lidarcodec.errors import PacketError, SectionError
from lidarcodec.interop.cdr import CdrReader, CdrWriter
from lidarcodec.packet import Packet
from lidarcodec.units import PACKET_BYTES

_STRIDE: Final = -(-(8 + PACKET_BYTES) // 4) * 4
_SECOND: Final = 10**9


def scan_of(packets: Sequence[Packet], frame_id: str) -> bytes:
    """A run of packets as a message.

    Raises SectionError for none, or a time outside 1901 to 2038, PacketError for a payload that has not 1206 bytes.
    """
    if not packets:
        raise SectionError("a scan without packets has no time")
    stamps = np.array([packet.stamp_ns for packet in packets], np.int64)
    seconds = stamps // _SECOND
    if np.abs(seconds).max() >= 2**31:
        raise SectionError("a ROS time is 32 bits of seconds (until 2038): these packets are stamped outside of it")
    for packet in packets:
        if len(packet.payload) != PACKET_BYTES:
            raise PacketError(f"a payload of {len(packet.payload)} bytes, not {PACKET_BYTES}")
    rows = np.zeros((len(packets), _STRIDE), np.uint8)
    rows[:, :4] = seconds.astype("<i4")[:, None].view(np.uint8)
    rows[:, 4:8] = (stamps - seconds * _SECOND).astype("<u4")[:, None].view(np.uint8)
    rows[:, 8 : 8 + PACKET_BYTES] = np.frombuffer(b"".join(p.payload for p in packets), np.uint8).reshape(
        -1, PACKET_BYTES
    )
    writer = CdrWriter().header(packets[-1].stamp_ns, frame_id).u32(len(packets)).align(4)
    return writer.raw(rows.tobytes()[: 8 + PACKET_BYTES - _STRIDE]).done()


def packets_of_scan(data: bytes) -> list[Packet]:
    """Packets of a message.

    Raises SectionError, or TruncatedError where it is shorter than it says.
    """
    reader = CdrReader(data)
    reader.stamp()
    reader.text()
    count = reader.u32()
    if not count:
        return []
    body = reader.raw(count * _STRIDE - (_STRIDE - 8 - PACKET_BYTES))  # longer than a message is: refused unread
    rows = np.zeros((count, _STRIDE), np.uint8)
    rows.ravel()[: len(body)] = np.frombuffer(body, np.uint8)
    seconds = rows[:, :4].copy().view(f"{reader.order}i4").ravel().astype(np.int64)
    nanos = rows[:, 4:8].copy().view(f"{reader.order}u4").ravel()
    if int(nanos.max()) >= _SECOND:
        raise SectionError(f"a packet with {int(nanos.max())} nanoseconds: a second has fewer")
    payloads = rows[:, 8 : 8 + PACKET_BYTES]
    stamps = (seconds * _SECOND + nanos).tolist()
    return [Packet(payload.tobytes(), stamp) for payload, stamp in zip(payloads, stamps, strict=True)]

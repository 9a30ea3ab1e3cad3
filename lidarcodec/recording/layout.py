"""Layout of a recording: an MCAP file (mcap.dev) with a channel of messages, a channel of raw packets, or both.

| encoding             | topic                                      | data of an MCAP message                    |
|----------------------|--------------------------------------------|--------------------------------------------|
| `lidarcodec`         | `lidarcodec/v1/{vehicle}/{sensor}/frame`   | one message as `wire.pack` gives it        |
| `lidarcodec.refine`  | `lidarcodec/v1/{vehicle}/{sensor}/refine`  | a refinement as `layers.pack` gives it     |
| `lidarcodec.packets` | `lidarcodec/v1/{vehicle}/{sensor}/packets` | a batch of packets, `pack_batch` |
| `protobuf`           | `lidarcodec/v1/{vehicle}/{sensor}/points`  | `foxglove.PointCloud`: points of a decoded
message |
| `protobuf`           | `lidarcodec/v1/{vehicle}/{sensor}/pose`    | `foxglove.FrameTransform`: pose of the sensor |
| `protobuf`           | `lidarcodec/v1/{vehicle}/{sensor}/mount`   | `foxglove.FrameTransform`: where the sensor sits |

With a mounting, the pose is that of the vehicle. The last three are optional. They are for viewers; lidarcodec itself
does not read them.

The MCAP log time is the stamp of the (first) frame or packet, the sequence its frame index modulo 2^32.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from itertools import pairwise
from typing import Final

import numpy as np

from lidarcodec.entropy import decode_positions, encode_positions
from lidarcodec.errors import PacketError, SectionError
from lidarcodec.packet import Packet
from lidarcodec.packet_rest import MAX_ODD_BYTES, MAX_ODD_TOTAL
from lidarcodec.side import Position

MESSAGE_ENCODING: Final = "lidarcodec"
PACKET_ENCODING: Final = "lidarcodec.packets"
REFINE_ENCODING: Final = "lidarcodec.refine"
_LAST_PART: Final = {MESSAGE_ENCODING: "frame", PACKET_ENCODING: "packets", REFINE_ENCODING: "refine"}
METADATA_NAME: Final = "lidarcodec"
"""Name of the MCAP metadata record: format, version, vehicle, sensor and the settings as JSON."""
LOSSES_NAME: Final = "lidarcodec.losses"
"""Name of the metadata record at the end with what was measured while frames were encoded: returns that come back in
percent, the largest error of a range, the error of intensities (RMS), frames left out."""
MAX_BATCH: Final = 16384
"""Most data packets in a batch: 20 MB."""

ALONE: Final = 0xFFFF
"""Size of a packet that is the rest of its batch."""
_COUNT: Final = struct.Struct("<I")
_STAMP: Final = struct.Struct("<q")


def topic(vehicle: str, sensor: str, encoding: str) -> str:
    """Topic of a sensor's channel of that encoding; for messages it is their Zenoh key."""
    return f"lidarcodec/v1/{vehicle}/{sensor}/{_LAST_PART[encoding]}"


def cloud_topics(vehicle: str, sensor: str) -> tuple[str, str, str]:
    """Topics of a sensor's clouds, poses and mountings, for viewers."""
    points, pose, mount = (f"lidarcodec/v1/{vehicle}/{sensor}/{name}" for name in ("points", "pose", "mount"))
    return points, pose, mount


def batches_of(packets: Sequence[Packet]) -> list[Sequence[Packet]]:
    """The packets as batches: all of them, or, where some are longer than UDP allows, each of these alone."""
    if not packets:
        return []
    long = [number for number, packet in enumerate(packets) if len(packet.payload) > MAX_ODD_BYTES]
    edges = [0, *(edge for number in long for edge in (number, number + 1)), len(packets)]
    return [packets[begin:end] for begin, end in pairwise(edges) if begin < end]


def pack_batch(packets: Sequence[Packet]) -> bytes:
    """Bytes of a batch of packets: count u32, stamps in ns i64, sizes u16 and payloads of data packets; if there are
    position packets, then the first packet's stamp i64 and the bytes of a POSITION section. A packet that is longer
    than UDP allows, as the messages of point clouds are, is the only one of its batch and has the size 65,535.

    Raises PacketError for such a packet among others, or one of more than 32 MiB, SectionError for none or
    too many.
    """
    data = [packet for packet in packets if not packet.position]
    if not packets or len(data) > MAX_BATCH:
        raise SectionError(f"a batch of {len(packets)} packets: 1 to {MAX_BATCH} are allowed")
    most = MAX_ODD_TOTAL if len(packets) == 1 else MAX_ODD_BYTES
    for packet in data:
        if len(packet.payload) > most:
            raise PacketError(f"a payload of {len(packet.payload)} bytes: the limit is {most}")
    stamps = np.array([packet.stamp_ns for packet in data], "<i8").tobytes()
    sizes = np.array([min(len(packet.payload), ALONE) for packet in data], "<u2").tobytes()
    packed = _COUNT.pack(len(data)) + stamps + sizes + b"".join(packet.payload for packet in data)
    if len(data) == len(packets):
        return packed
    begin_ns, place, positions = packets[0].stamp_ns, 0, []
    for packet in packets:
        if packet.position:
            positions.append(Position(place, packet.stamp_ns - begin_ns, packet.payload))
        else:
            place += 1
    return packed + _STAMP.pack(begin_ns) + encode_positions(tuple(positions), host_step_ns=1)


def unpack_batch(data: bytes) -> list[Packet]:
    """Packets of a batch.

    Raises SectionError or TruncatedError.
    """
    count = _COUNT.unpack_from(data)[0] if len(data) >= _COUNT.size else 0
    sizes_at = _COUNT.size + 8 * count
    at = end = sizes_at + 2 * count
    if count <= MAX_BATCH and at <= len(data):
        sizes = np.frombuffer(data[sizes_at:at], "<u2").astype(np.int64)
        if count == 1 and int(sizes[0]) == ALONE and MAX_ODD_BYTES < len(data) - at <= MAX_ODD_TOTAL:
            sizes[0] = len(data) - at
        end += int(sizes.sum())
    if count > MAX_BATCH or len(data) < max(end, _COUNT.size + 1) or end < len(data) <= end + _STAMP.size:
        raise SectionError(f"a batch of {count} packets in {len(data)} bytes")
    stamps = np.frombuffer(data[_COUNT.size : sizes_at], "<i8").tolist()
    ends = (at + np.cumsum(sizes)).tolist()
    packets = [
        Packet(data[begin:finish], stamp) for begin, finish, stamp in zip([at, *ends], ends, stamps, strict=False)
    ]
    if len(data) > end:
        (begin_ns,) = _STAMP.unpack_from(data, end)
        positions = decode_positions(data[end + _STAMP.size :], count)
        for one in reversed(positions):  # backwards, so that earlier places stay valid
            packets.insert(one.place, Packet(one.payload, begin_ns + one.offset_ns, position=True))
    return packets

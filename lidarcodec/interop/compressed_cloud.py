"""Messages of lidarcodec in `point_cloud_interfaces/CompressedPointCloud2`, ROS 2's type for compressed clouds.

It is the type of the transports of `point_cloud_transport`. `format` is `lidarcodec`, `compressed_data` is one message
as `wire.pack` gives it, and the stamp is that of the message. `fields` and `point_step` describe the points that a
decoder gives, as point_cloud2.py lays them out. `width` is 0: how many points there are is known after decoding.
"""

from __future__ import annotations

from typing import Final

from lidarcodec.errors import SectionError
from lidarcodec.interop.cdr import CdrReader, CdrWriter
from lidarcodec.interop.point_cloud2 import DATATYPES, POINT_DTYPE

FORMAT: Final = "lidarcodec"
TRANSPORT: Final = "lidarcodec"
"""Last part of the topic, after that of the points: the name of the transport."""
_MAX_FIELDS: Final = 1024


def coded_topic(points_topic: str) -> str:
    """The topic of compressed clouds that belongs to a topic of clouds.

    >>> coded_topic("/car_7/roof/points")
    '/car_7/roof/points/lidarcodec'
    """
    return f"{points_topic}/{TRANSPORT}"


def compressed_cloud(message: bytes, stamp_ns: int, frame_id: str) -> bytes:
    """A message of lidarcodec, as `wire.pack` gives it, in a CompressedPointCloud2. stamp_ns: that of the message"""
    writer = CdrWriter().header(stamp_ns, frame_id).u32(1).u32(0).u32(len(POINT_DTYPE.names or ()))
    for name, (dtype, offset, *_) in dict(POINT_DTYPE.fields or {}).items():
        writer.text(name).u32(offset).u8(DATATYPES[dtype.str]).u32(1)
    writer.u8(0).u32(POINT_DTYPE.itemsize).u32(0).u32(len(message)).raw(message)
    return writer.u8(1).text(FORMAT).done()


def message_of(data: bytes) -> bytes:
    """The message of lidarcodec in a CompressedPointCloud2.

    Raises SectionError for one of another format, TruncatedError.
    """
    reader = CdrReader(data)
    reader.stamp()
    reader.text()
    reader.u32()
    reader.u32()
    count = reader.u32()
    if count > _MAX_FIELDS:
        raise SectionError(f"a CompressedPointCloud2 with {count} fields: {_MAX_FIELDS} are allowed")
    for _ in range(count):
        reader.text()
        reader.u32()
        reader.raw(1)
        reader.u32()
    reader.raw(1)
    reader.u32()
    reader.u32()
    message = bytes(reader.raw(reader.u32()))
    reader.raw(1)
    form = reader.text()
    if form != FORMAT:
        raise SectionError(f"a CompressedPointCloud2 of format '{form[:32]}': only '{FORMAT}' is decoded here")
    return message

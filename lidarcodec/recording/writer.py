"""Writer of recordings. Every message is an MCAP chunk of its own, so that a cut file keeps everything before the cut.

With clouds, decoded points are stored too, as compressed messages of Foxglove, so that viewers without lidarcodec can
show the file.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import TracebackType
from typing import IO, Final

from mcap.writer import CompressionType, Writer

import lidarcodec
from lidarcodec import wire
from lidarcodec.entropy.zstd_memory import memory_told
from lidarcodec.errors import HeaderError, SourceError
from lidarcodec.frame import Frame
from lidarcodec.interop import foxglove
from lidarcodec.packet import Packet
from lidarcodec.recording.layout import (
    MESSAGE_ENCODING,
    METADATA_NAME,
    PACKET_ENCODING,
    batches_of,
    cloud_topics,
    pack_batch,
    topic,
)
from lidarcodec.recording.records import Channel, Stored
from lidarcodec.settings import StreamSettings, valid_name
from lidarcodec.wire.header import MAJOR, MINOR

_ONE_MESSAGE: Final = 1
"""Chunk size. The MCAP writer closes a chunk of this size, so after each message."""


class RecordingWriter:
    """Writes messages, packets or both of one sensor to an open binary file, which the caller closes."""

    def __init__(
        self,
        stream: IO[bytes],
        vehicle: str,
        sensor: str,
        settings: StreamSettings | None = None,
        metadata: Mapping[str, str] | None = None,
        *,
        clouds: bool = False,
    ) -> None:
        """metadata: further texts to store;  clouds: whether `write_cloud` may be called

        Raises SettingsError for an invalid name.
        """
        self.vehicle, self.sensor = valid_name(vehicle, "vehicle"), valid_name(sensor, "sensor")
        self._stream = stream
        self._finished = False
        self._channels: dict[str, int] = {}
        compression = CompressionType.ZSTD if clouds else CompressionType.NONE  # messages cannot be compressed further
        self._mcap = Writer(stream, chunk_size=_ONE_MESSAGE, compression=compression)
        self._mcap.start(profile="", library=f"lidarcodec {lidarcodec.__version__}")
        about = {
            "format": f"{MAJOR}.{MINOR}",
            "version": lidarcodec.__version__,
            "vehicle": vehicle,
            "sensor": sensor,
            **({} if settings is None else {"settings": settings.model_dump_json()}),
        }
        self._mcap.add_metadata(METADATA_NAME, dict(metadata or {}) | about)

    def write(self, data: bytes) -> None:
        """Add one message, packed by `wire.pack`, and pass it to the operating system.

        Raises DecodeError if the bytes do not begin with the header of a message of this length, OSError.
        """
        header = wire.peek(data)
        if header.total_bytes != len(data):
            raise HeaderError(f"the message should have {header.total_bytes} bytes, but has {len(data)}", 8)
        self._add(MESSAGE_ENCODING, header.stamp_ns, data, header.frame_index)

    def write_packets(self, packets: Sequence[Packet]) -> None:
        """Add a batch of raw packets, for example of one frame; an empty batch is not written.

        Raises PacketError, SectionError, OSError.
        """
        for batch in batches_of(packets):
            self._add(PACKET_ENCODING, batch[0].stamp_ns, pack_batch(batch), 0)

    def write_cloud(self, frame: Frame) -> None:
        """Add the points of a decoded frame as `foxglove.PointCloud`, and its pose if it has one.

        Cost: 18 ms and 1.85 MB for a frame of 120,000 points. Raises OSError.
        """
        cloud_topic, transform_topic = cloud_topics(self.vehicle, self.sensor)
        name = f"{self.vehicle}/{self.sensor}"
        if frame.pose is not None:
            data = foxglove.frame_transform(frame.stamp_ns, foxglove.WORLD, name, frame.pose)
            self._add_foxglove(transform_topic, foxglove.FRAME_TRANSFORM, frame, data)
        self._add_foxglove(cloud_topic, foxglove.POINT_CLOUD, frame, foxglove.point_cloud(frame, name))

    def copy(self, channel: Channel, schema: str, stored: Stored) -> None:
        """Add a message of another recording unchanged. schema: name of its type, empty if it has none.

        Raises SourceError for a type that recordings of lidarcodec do not have, OSError.
        """
        if channel.topic not in self._channels:
            number = 0
            if schema:
                known = {one.name: one for one in (foxglove.POINT_CLOUD, foxglove.FRAME_TRANSFORM)}.get(schema)
                if known is None:
                    raise SourceError(
                        f"{channel.topic} has type {schema}, which recordings of lidarcodec do not have: leave it out"
                    )
                number = self._mcap.register_schema(known.name, foxglove.ENCODING, known.data)
            self._channels[channel.topic] = self._mcap.register_channel(channel.topic, channel.encoding, number)
        self._store(self._channels[channel.topic], stored.log_time, stored.data(), stored.sequence)

    @property
    def bytes_written(self) -> int:
        """Bytes of the file so far."""
        return self._stream.tell()

    def close(self) -> None:
        """Write index and footer. A second call does nothing. The file itself stays open."""
        if not self._finished:
            self._finished = True
            with memory_told():
                self._mcap.finish()  # type: ignore[no-untyped-call]
            self._stream.flush()

    def __enter__(self) -> RecordingWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _add(self, encoding: str, stamp_ns: int, data: bytes, sequence: int) -> None:
        if encoding not in self._channels:
            name = topic(self.vehicle, self.sensor, encoding)
            self._channels[encoding] = self._mcap.register_channel(name, encoding, schema_id=0)
        self._store(self._channels[encoding], stamp_ns, data, sequence)

    def _add_foxglove(self, name: str, schema: foxglove.Schema, frame: Frame, data: bytes) -> None:
        if name not in self._channels:
            number = self._mcap.register_schema(schema.name, foxglove.ENCODING, schema.data)
            self._channels[name] = self._mcap.register_channel(name, foxglove.ENCODING, schema_id=number)
        self._store(self._channels[name], frame.stamp_ns, data, frame.index)

    def _store(self, channel: int, stamp_ns: int, data: bytes, sequence: int) -> None:
        at = max(0, stamp_ns)  # MCAP has no times before 1970
        with memory_told():
            self._mcap.add_message(channel, at, data, at, sequence & 0xFFFFFFFF)
        self._stream.flush()

"""Writer of recordings. Every message is an MCAP chunk of its own, so that a cut file keeps everything before the cut.

With clouds, decoded points are stored too, as compressed messages of Foxglove, so that viewers without lidarcodec can
show the file.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import IO, Final

import lidarcodec
from lidarcodec import wire
from lidarcodec.errors import HeaderError, SourceError
from lidarcodec.frame import Frame
from lidarcodec.interop import foxglove
from lidarcodec.layers import peek_refinement
from lidarcodec.layers.message import announced_size
from lidarcodec.packet import Packet
from lidarcodec.recording.layout import (
    LOSSES_NAME,
    MESSAGE_ENCODING,
    METADATA_NAME,
    PACKET_ENCODING,
    REFINE_ENCODING,
    batches_of,
    cloud_topics,
    pack_batch,
    topic,
)
from lidarcodec.recording.mcap_file import McapFile
from lidarcodec.recording.records import Channel, Stored
from lidarcodec.settings import StreamSettings, valid_name
from lidarcodec.wire.header import MAJOR, MINOR

_ONE_MESSAGE: Final = 1
"""Chunk size. The MCAP writer closes a chunk of this size, so after each message."""


class RecordingWriter(McapFile):
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
        super().__init__(stream, _ONE_MESSAGE, compressed=clouds)  # messages cannot be compressed further
        self._channels: dict[str, int] = {}
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
        name = topic(self.vehicle, self.sensor, MESSAGE_ENCODING)
        self._add(name, MESSAGE_ENCODING, header.stamp_ns, data, header.frame_index)

    def write_refinement(self, data: bytes) -> None:
        """Add one refinement, packed by `layers.pack`, and pass it to the operating system.

        Raises DecodeError if the bytes do not begin with the header of a refinement of this length, OSError.
        """
        head = peek_refinement(data)
        if (total := announced_size(data)) != len(data):
            raise HeaderError(f"the refinement should have {total} bytes, but has {len(data)}", 8)
        name = topic(self.vehicle, self.sensor, REFINE_ENCODING)
        self._add(name, REFINE_ENCODING, head.stamp_ns, data, head.frame_index)

    def write_packets(self, packets: Sequence[Packet]) -> None:
        """Add a batch of raw packets, for example of one frame; an empty batch is not written.

        Raises PacketError, SectionError, OSError.
        """
        name = topic(self.vehicle, self.sensor, PACKET_ENCODING)
        for batch in batches_of(packets):
            self._add(name, PACKET_ENCODING, batch[0].stamp_ns, pack_batch(batch), 0)

    def write_cloud(self, frame: Frame) -> None:
        """Add the points of a decoded frame as `foxglove.PointCloud`, and its pose and mounting if it has them.

        Cost: 18 ms and 1.85 MB for a frame of 120,000 points. Raises OSError.
        """
        cloud_topic, pose_topic, mount_topic = cloud_topics(self.vehicle, self.sensor)
        name = f"{self.vehicle}/{self.sensor}"
        posed, placed = foxglove.transforms_of(frame, self.vehicle, name)
        for where, transform in ((pose_topic, posed), (mount_topic, placed)):
            if transform is not None:
                self._add(where, foxglove.ENCODING, frame.stamp_ns, transform, frame.index, foxglove.FRAME_TRANSFORM)
        cloud = foxglove.point_cloud(frame, name)
        self._add(cloud_topic, foxglove.ENCODING, frame.stamp_ns, cloud, frame.index, foxglove.POINT_CLOUD)

    def write_losses(self, texts: Mapping[str, str]) -> None:
        """Add what was measured while all frames were encoded, behind them."""
        self._mcap.add_metadata(LOSSES_NAME, dict(texts))
        self._stream.flush()

    def copy(self, channel: Channel, schema: str, stored: Stored) -> None:
        """Add a message of another recording unchanged. schema: name of its type, empty if it has none.

        Raises SourceError for a type that recordings of lidarcodec do not have, OSError.
        """
        if schema and schema not in foxglove.SCHEMAS:
            raise SourceError(
                f"{channel.topic} has type {schema}, which a recording of lidarcodec cannot hold: leave it out"
            )
        known = foxglove.SCHEMAS.get(schema)
        self._add(channel.topic, channel.encoding, stored.log_time, stored.data(), stored.sequence, known)

    @property
    def bytes_written(self) -> int:
        """Bytes of the file so far."""
        return self._stream.tell()

    def _add(
        self,
        name: str,
        encoding: str,
        stamp_ns: int,
        data: bytes,
        sequence: int,
        schema: foxglove.Schema | None = None,
    ) -> None:
        if name not in self._channels:
            number = 0 if schema is None else self._mcap.register_schema(schema.name, foxglove.ENCODING, schema.data)
            self._channels[name] = self._mcap.register_channel(name, encoding, number)
        self._add_message(self._channels[name], stamp_ns, data, sequence)
        self._stream.flush()

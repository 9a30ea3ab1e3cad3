"""What `mcap doctor` would say of our files: its rules, applied by the MCAP project's own reader for Python."""

from __future__ import annotations

import zlib
from pathlib import Path
from typing import Any

import pytest
from mcap import records
from mcap.stream_reader import StreamReader, breakup_chunk

from lidarcodec import wire
from lidarcodec.pipeline import StreamEncoder, frames_of
from lidarcodec.recording import RecordingWriter, RosbagWriter
from lidarcodec.settings import StreamSettings
from tests import packets as made

PROFILES = ("", "ros1", "ros2")


class Doctor:
    """Examines a file. said: errors and warnings, but one;  earlier: messages before the ones before them, which is
    allowed, and only a warning. The rules are those of the command, as of September 2024."""

    def __init__(self, path: Path) -> None:
        self.said: list[str] = []
        self.schemas: dict[int, records.Schema] = {}
        self.channels: dict[int, records.Channel] = {}
        self.counts: dict[int, int] = {}
        self.last = self.chunks = self.earlier = 0
        self.seen: set[str] = set()
        self.indexed: dict[int, set[tuple[int, int]]] = {}
        self.messages: dict[int, set[tuple[int, int]]] = {}
        with path.open("rb") as file:
            for record in StreamReader(file, emit_chunks=True, validate_crcs=True).records:
                self.seen.add(type(record).__name__)
                getattr(self, f"_{type(record).__name__}", lambda one: None)(record)
        self._check(self.seen >= {"DataEnd", "Footer", "Statistics"}, "the end is missing")

    def _check(self, holds: bool, what: str) -> None:
        if not holds:
            self.said.append(what)

    def _Header(self, header: records.Header) -> None:
        self._check(header.library != "", "no library")
        self._check(header.profile in PROFILES, f"profile {header.profile}")

    def _Schema(self, schema: records.Schema) -> None:
        self._check(schema.id != 0 and schema.encoding != "", f"schema {schema.name} without a number or an encoding")
        self._check(self.schemas.setdefault(schema.id, schema) == schema, f"two schemas {schema.id}")

    def _Channel(self, channel: records.Channel) -> None:
        self._check(channel.message_encoding != "", f"{channel.topic} without an encoding")
        self._check(
            channel.schema_id == 0 or channel.schema_id in self.schemas, f"{channel.topic}: no schema before it"
        )
        self._check(self.channels.setdefault(channel.id, channel) == channel, f"two channels {channel.id}")

    def _Message(self, message: records.Message) -> None:
        self._check(False, "a message outside of chunks: indexed readers miss it")

    def _Chunk(self, chunk: records.Chunk) -> None:
        self._check(self.indexed == self.messages, "an index that does not fit its chunk")
        self.indexed, self.messages, self.chunks = {}, {}, self.chunks + 1
        times, at = [], 0
        for record in breakup_chunk(chunk, validate_crc=True):
            if isinstance(record, records.Message):
                self._check(record.channel_id in self.channels, "a message before its channel")
                self.earlier += record.log_time < self.last
                self.last = max(self.last, record.log_time)
                self.counts[record.channel_id] = self.counts.get(record.channel_id, 0) + 1
                self.messages.setdefault(record.channel_id, set()).add((record.log_time, at))
                times.append(record.log_time)
            else:
                getattr(self, f"_{type(record).__name__}")(record)
            at += 9 + _size_of(record)
        self._check(at == chunk.uncompressed_size, "the size of a chunk")
        if times:
            span = (chunk.message_start_time, chunk.message_end_time)
            self._check(span == (min(times), max(times)), "the times of a chunk")
        if chunk.compression == "" and chunk.uncompressed_crc:
            self._check(zlib.crc32(chunk.data) == chunk.uncompressed_crc, "the checksum of a chunk")

    def _MessageIndex(self, index: records.MessageIndex) -> None:
        self._check(index.channel_id not in self.indexed, "two indexes of a channel")
        if index.records:
            self.indexed[index.channel_id] = set(index.records)

    def _ChunkIndex(self, index: records.ChunkIndex) -> None:
        self.chunks -= 1

    def _Statistics(self, told: records.Statistics) -> None:
        self._check(self.indexed == self.messages, "an index that does not fit the last chunk")
        self._check(told.channel_message_counts == self.counts, "the counts of messages")
        self._check(told.message_count == sum(self.counts.values()), "the count of all messages")

    def _Footer(self, footer: records.Footer) -> None:
        self._check(self.chunks == 0, "chunks without an index, or indexes without a chunk")


def _size_of(record: Any) -> int:
    """Bytes of a record in a chunk, without its head."""
    if isinstance(record, records.Message):
        return 22 + len(record.data)
    if isinstance(record, records.Schema):
        return 2 + 4 + len(record.name.encode()) + 4 + len(record.encoding) + 4 + len(record.data)
    about = sum(8 + len(one.encode()) + len(other.encode()) for one, other in record.metadata.items())
    return 2 + 2 + 4 + len(record.topic.encode()) + 4 + len(record.message_encoding) + 4 + about


FRAMES = list(frames_of(iter(made.turning(1044)), made.sensor()))
MESSAGES = [wire.pack(message) for frame in FRAMES for message in StreamEncoder(StreamSettings()).encode(frame)]


def recording(file: Any) -> None:
    with RecordingWriter(file, "car-7", "roof") as writer:
        for data in MESSAGES:
            writer.write(data)


def with_clouds_and_packets(file: Any) -> None:
    with RecordingWriter(file, "car-7", "roof", clouds=True) as writer:
        for frame, data in zip(FRAMES, MESSAGES, strict=True):
            writer.write(data)
            writer.write_cloud(frame)


def packets(file: Any) -> None:
    with RecordingWriter(file, "car-7", "roof") as writer:
        writer.write_packets(made.turning(400))


def rosbag(file: Any) -> None:
    with RosbagWriter(file) as writer:
        writer.write_scan(made.turning(348))
        for frame in FRAMES[1:]:
            writer.write_cloud(frame)


def coded(file: Any) -> None:
    with RosbagWriter(file, points_topic="/points") as writer:
        for data in MESSAGES:
            writer.write_coded(data, None)


@pytest.mark.parametrize("write", [recording, with_clouds_and_packets, packets, rosbag, coded])
def test_mcap_doctor_has_nothing_to_say(tmp_path, write):
    with (tmp_path / "a.mcap").open("wb") as file:
        write(file)
    doctor = Doctor(tmp_path / "a.mcap")
    assert doctor.said == []
    # A scan in a bag has the time of its last packet, and its cloud that of the first one, as from the driver.
    assert doctor.earlier == 0 or write is rosbag


def test_the_doctor_finds_what_is_wrong(tmp_path):
    """A file whose statistics tell of a message more than there are, and whose messages go back in time."""
    path = tmp_path / "a.mcap"
    with path.open("wb") as file, RecordingWriter(file, "car-7", "roof") as writer:
        for data in (MESSAGES[1], MESSAGES[0]):
            writer.write(data)
    doctor = Doctor(path)
    assert (doctor.said, doctor.earlier) == ([], 1)
    doctor._Statistics(records.Statistics(0, 0, 3, {0: 3}, 0, 0, 1, 0, 2))
    assert doctor.said == ["the counts of messages", "the count of all messages"]

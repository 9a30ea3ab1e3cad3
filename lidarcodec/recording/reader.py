"""Reader of complete and cut recordings: it gives every complete message, and counts lost ones."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import suppress
from itertools import islice
from typing import IO, Final, NamedTuple

from lidarcodec import wire
from lidarcodec.errors import DecodeError, SourceError
from lidarcodec.packet import Packet
from lidarcodec.recording import records
from lidarcodec.recording.layout import (
    LOSSES_NAME,
    MESSAGE_ENCODING,
    METADATA_NAME,
    PACKET_ENCODING,
    REFINE_ENCODING,
    unpack_batch,
)
from lidarcodec.recording.order import in_sent_order
from lidarcodec.recording.records import Channel, DamagedError, Record, Stored, Work
from lidarcodec.recording.refinements import Refinements

logger = logging.getLogger(__name__)

_LOOKED_AT: Final = 1000
"""Messages of the first chunk that are looked at for the channels at the beginning."""
_MAX_CHANNELS: Final = 4096
_MAX_STREAMS: Final = 4096
"""Most stream ids that are remembered: a hostile file may have a new one in each message."""
_MAX_PLACES: Final = 1 << 20
_Times = tuple[int, int] | None
"""Most remembered places to begin reading: 130 MB."""


class _Place(NamedTuple):
    """A place to begin reading: offset of a record of the data section, and messages to skip in it."""

    record: int
    skip: int


class RecordingReader:
    """Reads a recording from an open binary file that can seek. The caller closes the file.

    metadata: texts of the writer (vehicle, sensor, settings, ...); empty for files of other programs
    losses: what was measured while its frames were encoded, once they have been read; empty if that is not known
    profile: MCAP profile of the file, such as `ros2`; empty for recordings of lidarcodec
    channels: channels at the beginning of the file, by id;  schemas: names of types, by id
    size: bytes of the file
    counts: counts of the last reading: `cut` (1 if the end is missing), `bytes lost` there, `damaged` chunks and
        batches, `mixed streams`: how often a stream came back after another one, because two publishers had the same
        name, `late messages`: messages too late to be sorted, `other topics`: messages of topics that are not read
    """

    def __init__(self, stream: IO[bytes], warn: bool = True, instead: str = "") -> None:
        """warn: False if the same file is read again, so that its warnings are not logged twice
        instead: what the error for another file adds

        Raises SourceError if it is not an MCAP file.
        """
        self._stream = stream
        self._size = self.size = records.size_of(stream)
        self.counts: Counter[str] = Counter()
        self.metadata: dict[str, str] = {}
        self.losses: dict[str, str] = {}
        self.channels: dict[int, Channel] = {}
        self.schemas: dict[int, str] = {}
        self.profile = ""
        self.refinements = Refinements()
        """Refinements of messages that `messages` gave, or will give soon."""
        self._warned = not warn
        self._summarised = False
        self._times: _Times = None
        self._work = Work()
        self._name = str(getattr(stream, "name", "this"))
        magic = records.read(stream, 0, min(self._size, len(records.MAGIC)))
        if not magic or not records.MAGIC.startswith(magic):
            raise SourceError(f"{self._name} is not a recording (.mcap){instead}")
        self._data_start = min(self._size, len(records.MAGIC))
        self._read_beginning()

    def messages(self, start_ns: int | None = None, topic: str | None = None) -> Iterator[tuple[int, bytes]]:
        """(stamp in ns, bytes) of each message, in the order in which they were sent (`order.in_sent_order`).

        start_ns: begin at the last key message at or before this time, or at the first message if there is none
        topic: topic of the channels to read; by default the topic of the first channel with messages
        """
        return in_sent_order(self._as_recorded(start_ns, topic), self._late)

    def _as_recorded(self, start_ns: int | None, topic: str | None) -> Iterator[tuple[int, bytes]]:
        streams: dict[int, None] = {}
        last: int | None = None
        self.refinements.clear()
        for stored in self._read(MESSAGE_ENCODING, topic, start_ns, _is_key, REFINE_ENCODING):
            data = stored.data()
            if self.channels[stored.channel].encoding == REFINE_ENCODING:
                self.refinements.put(data)
                continue
            with suppress(DecodeError):  # the decoder of the message reports the error
                stream = wire.peek(data).stream_id
                if stream != last and stream in streams:
                    self._mixed()
                if len(streams) < _MAX_STREAMS:
                    streams[stream] = None
                last = stream
            yield stored.log_time, data

    def packets(self, start_ns: int | None = None, topic: str | None = None) -> Iterator[Packet]:
        """Raw packets in the order of the recording; with `start_ns` from the batch that contains this time."""
        for stored in self._read(PACKET_ENCODING, topic, start_ns, lambda _: True):
            try:
                yield from unpack_batch(stored.data())
            except DecodeError as error:
                self._damaged(error)

    def others(self, encoding: str, topic: str) -> Iterator[tuple[int, bytes]]:
        """(log time in ns, bytes) of each message in a channel of another program, in the order of the file."""
        for stored in self._read(encoding, topic, None, lambda _: True):
            yield stored.log_time, stored.data()

    def everything(self) -> Iterator[tuple[Channel, Stored]]:
        """Every message of every channel, in the order of the file."""
        self.counts.clear()
        for _, stored in self._walk(self._data_start):
            for one in stored:
                channel = self._channel(one.channel)
                if channel is not None:
                    yield channel, one

    def leave_out_rest(self, why: str) -> None:
        """Count and log that the rest is not read. why: the reason"""
        self._damaged(DamagedError(f"{why}; the rest was not read"))

    def topics(self) -> dict[str, str]:
        """The type of every topic with a schema, anywhere in the file."""
        if not self._indexed():
            self._scanned()
        return {one.topic: self.schemas[one.schema] for one in self.channels.values() if one.schema in self.schemas}

    def span(self) -> tuple[int, int] | None:
        """Earliest and latest stamp in ns of the complete messages; None if there is none.

        They need not be those of the first and the last one: a clock may have been set back meanwhile.
        """
        return self._times if self._indexed() or self._scanned() else None

    def _read_beginning(self) -> None:
        """Metadata and channels up to the first message."""
        try:
            self.profile = records.profile_of(self._stream, self._data_start, self._size)
            for record in records.records(self._stream, self._data_start, self._size):
                if record.opcode == records.METADATA and record.whole and record.length <= records.MAX_ABOUT:
                    name, texts = records.metadata_of(self._stream, record)
                    if name == METADATA_NAME:
                        self.metadata = texts
                elif list(islice(self._inside(record, check=False), _LOOKED_AT)) or record.opcode == records.DATA_END:
                    return
        except DamagedError:
            return  # the error is counted when messages are read

    def _learn_of(self, source: IO[bytes], record: Record) -> None:
        """Remember a channel or a schema, if this record is one."""
        if record.opcode == records.CHANNEL and record.whole and len(self.channels) < _MAX_CHANNELS:
            channel = records.channel_of(source, record)
            self.channels[channel.number] = channel
        elif record.opcode == records.SCHEMA and record.whole and len(self.schemas) < _MAX_CHANNELS:
            number, name = records.schema_of(source, record)
            self.schemas[number] = name
        elif record.opcode == records.METADATA and record.whole and record.length <= records.MAX_ABOUT:
            title, texts = records.metadata_of(source, record)
            if title == LOSSES_NAME:
                self.losses = texts

    def _inside(self, record: Record, check: bool = True) -> Iterator[Stored]:
        """Messages of a record of the data section; learns the channels in it."""
        source, inner = self._stream, [record].__iter__()
        reached = end = 0
        if record.opcode == records.CHUNK:
            chunk = records.chunk_of(self._stream, record)
            self._work.open(chunk)
            source, reached, end = records.opened(self._stream, chunk, self._size, check)
            inner = self._work.count(records.records(source, reached, end), chunk)
        for one in inner:
            if one.whole:
                reached = one.end
            if one.opcode == records.MESSAGE and one.whole:
                yield records.stored_of(source, one)
            else:
                self._learn_of(source, one)
        if record.opcode == records.CHUNK and record.whole and reached < end:
            raise DamagedError("the records of a chunk end before the chunk")

    def _walk(self, start: int, check: bool = True) -> Iterator[tuple[int, list[Stored]]]:
        """(offset, messages) of each record of the data section. Counts damage, and at the end lost bytes."""
        end = start
        count = 0
        self._work = Work()
        for record in self._records(start):
            if record.opcode in (records.DATA_END, records.FOOTER):
                self._look_at_end(record, count if start == self._data_start else None)
                return
            stored: list[Stored] = []
            try:
                stored.extend(self._inside(record, check))
            except DamagedError as error:
                if record.whole:
                    self._damaged(error)
            if record.whole:
                end = record.end
            elif stored:
                end = stored[-1].start + stored[-1].length
            count += len(stored)
            yield record.offset, stored
        self.counts["cut"], self.counts["bytes lost"] = 1, self._size - end
        self._warn(f"{self._name} was cut off: {self._size - end} bytes after its last complete message are lost")

    def _records(self, start: int) -> Iterator[Record]:
        """The records of the file, or of what is left of it: a program may make it shorter while it is read."""
        with suppress(DamagedError):
            yield from records.records(self._stream, start, self._size)

    def _look_at_end(self, record: Record, count: int | None) -> None:
        """Count and log what is wrong behind the data section. count: of all its messages; None if not all were read"""
        try:
            self._look_behind(record)
            if count is not None and not self.counts["damaged"]:
                self._compare(count)
        except DamagedError as error:
            self._damaged(error)

    def _compare(self, count: int) -> None:
        """Count and log if there are fewer messages than in the file's statistics. A flipped bit in an opcode can
        hide a chunk, or end the data early.
        """
        start = records.summary_start(self._stream, self._size)
        for record in records.records(self._stream, start, self._size) if start is not None else ():
            if record.opcode == records.STATISTICS and record.whole and record.length >= 8:
                told = records.message_count(self._stream, record)
                if told > count:
                    self._damaged(DamagedError(f"only {count} of its {told} messages were found"))

    def _look_behind(self, record: Record) -> None:
        """Count and log bytes after the end of the recording, for example of files joined with `cat`."""
        end = record.end
        for following in records.records(self._stream, record.offset, self._size):
            end = following.end
            if following.opcode == records.FOOTER:
                break
        behind = self._size - end - len(records.MAGIC)
        if behind > 0:
            self.counts["bytes lost"] = behind
            self._damaged(
                DamagedError(f"{behind} bytes after its end were not read: to join recordings, use `lidarcodec join`")
            )

    def _read(
        self,
        encoding: str,
        topic: str | None,
        start_ns: int | None,
        may_start: Callable[[Stored], bool],
        beside: str = "",
    ) -> Iterator[Stored]:
        """Messages of one channel; with `start_ns` from the last message at or before it that needs no other
        message. beside: encoding of further channels that are read too
        """
        place = _Place(self._data_start, 0)
        if start_ns is not None:
            place = self._last_place(encoding, topic, start_ns, may_start) or place
        self.counts.clear()
        for offset, stored in self._walk(place.record):
            for one in stored[place.skip if offset == place.record else 0 :]:
                if self._is(one.channel, encoding, topic) or (beside and self._has(one.channel, beside)):
                    yield one
                elif topic is None and (channel := self.channels.get(one.channel)) and channel.encoding == encoding:
                    self._of_another_topic(channel.topic)

    def _is(self, number: int, encoding: str, topic: str | None) -> bool:
        channel = self._channel(number)
        if channel is None or channel.encoding != encoding:
            return False
        if topic is not None:
            return channel.topic == topic
        first = min(one.number for one in self.channels.values() if one.encoding == encoding)
        return channel.topic == self.channels[first].topic

    def _has(self, number: int, encoding: str) -> bool:
        channel = self._channel(number)
        return channel is not None and channel.encoding == encoding

    def _channel(self, number: int) -> Channel | None:
        """A channel by its id. If its record is in a damaged chunk, it is read from the summary."""
        if number not in self.channels and not self._summarised:
            self._summarised = True
            self._indexed()
        return self.channels.get(number)

    def _last_place(
        self, encoding: str, topic: str | None, start_ns: int, may_start: Callable[[Stored], bool]
    ) -> _Place | None:
        places = self._indexed() or self._scanned()
        earlier: list[int] = []
        for first_time, offset in places:
            if first_time > start_ns:
                break
            earlier.append(offset)
        for offset in reversed(earlier):
            for at, stored in self._walk(offset, check=False):
                fits = [
                    number
                    for number, one in enumerate(stored)
                    if one.log_time <= start_ns and self._is(one.channel, encoding, topic) and may_start(one)
                ]
                if fits:
                    return _Place(at, fits[-1])
                break
        return None

    def _indexed(self) -> list[tuple[int, int]]:
        """(time of the first message, offset) of each chunk, from the file's index; empty if it has none."""
        found: list[tuple[int, int]] = []
        times: _Times = None
        try:
            start = records.summary_start(self._stream, self._size)
            if start is None:
                return []
            for record in records.records(self._stream, start, self._size):
                self._learn_of(self._stream, record)
                if record.opcode == records.CHUNK_INDEX:
                    first, last, offset = records.chunk_span(self._stream, record)
                    times = _with(times, first, last)
                    found.append((first, offset))
                    _thin(found)
        except DamagedError:
            return []
        self._times = times
        return found if all(self._data_start <= offset < start for _, offset in found) else []

    def _scanned(self) -> list[tuple[int, int]]:
        """The same from the data section, without reading messages."""
        found: list[tuple[int, int]] = []
        times: _Times = None
        for at, stored in self._walk(self._data_start, check=False):
            if stored:
                times = _with(times, min(one.log_time for one in stored), max(one.log_time for one in stored))
                found.append((stored[0].log_time, at))
                _thin(found)
        self._times = times
        return found

    def _damaged(self, error: Exception) -> None:
        self.counts["damaged"] += 1
        self._warn(f"{self._name} is damaged, and a part of it was skipped: {error}")

    def _mixed(self) -> None:
        self.counts["mixed streams"] += 1
        self._warn(f"{self._name} has frames of two streams: two publishers used the same name")

    def _late(self) -> None:
        self.counts["late messages"] += 1
        self._warn(f"{self._name} has messages that came too late to be sorted: frame numbers decrease there")

    def _of_another_topic(self, topic: str) -> None:
        self.counts["other topics"] += 1
        self._warn(f"{self._name} also has messages of {topic}, which were skipped: ?topic={topic} reads them")

    def _warn(self, text: str) -> None:
        if not self._warned:
            self._warned = True
            logger.warning("%s", text)


def _with(times: _Times, first: int, last: int) -> _Times:
    """Earliest and latest of all times."""
    return (first, last) if times is None else (min(times[0], first), max(times[1], last))


def _thin(places: list[tuple[int, int]]) -> None:
    """Remove every second place if there are too many; reading may then begin a little earlier."""
    if len(places) > _MAX_PLACES:
        del places[1::2]


def _is_key(stored: Stored) -> bool:
    try:
        return wire.peek(stored.data(wire.HEADER_BYTES)).key
    except DecodeError:
        return False


def read_recording(stream: IO[bytes], start_ns: int | None = None) -> Iterator[tuple[int, bytes]]:
    """(stamp in ns, bytes) of each message of a recording; see `RecordingReader`.

    Raises SourceError if the file is not a recording.
    """
    return RecordingReader(stream).messages(start_ns)

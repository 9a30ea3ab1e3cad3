"""`encode RECORDING OUT` without any setting: messages are kept as they are; `--with-clouds` adds their points."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from lidarcodec import wire
from lidarcodec.commands.cut.recordings import numbered, planned, units_of
from lidarcodec.commands.progress import progress
from lidarcodec.commands.results.files import Converted
from lidarcodec.commands.running import remaining
from lidarcodec.commands.running.stopping import Watched, stoppable
from lidarcodec.commands.running.telling import tell
from lidarcodec.commands.selection.frames import Selection
from lidarcodec.commands.unkept import positions_of
from lidarcodec.errors import DecodeError, SourceError
from lidarcodec.evaluation.coded_recording import Named
from lidarcodec.files.whole import whole
from lidarcodec.frame import Frame
from lidarcodec.pipeline import StreamDecoder
from lidarcodec.recording import MESSAGE_ENCODING, RecordingReader, RecordingWriter
from lidarcodec.recording.decoding_work import decoded
from lidarcodec.recording.layout import REFINE_ENCODING
from lidarcodec.recording.records import Channel, Stored
from lidarcodec.sources.recording import RecordingSource
from lidarcodec.sources.unit_calibration import warn_if_generic
from lidarcodec.units import counted

logger = logging.getLogger(__name__)


@dataclass
class _Kept:
    """Numbers of what was copied. left_out: damaged messages;  undecoded: messages without points"""

    frames: int = 0
    packets: int = 0
    positions: int = 0
    size: int = 0
    left_out: int = 0
    undecoded: int = 0


def run(
    source: RecordingSource,
    out: Path,
    selection: Selection,
    named: Named,
    *,
    clouds: bool,
    force: bool,
    as_json: bool,
) -> None:
    """Copy the messages of a recording, and their refinements. Damaged ones are left out, with a warning."""
    path, kept = source.path, _Kept()
    with (
        source.opened() as handle,
        source.opened() as again,
        stoppable() as stopped,
        progress("copying", selection.frames) as tick,
        whole(out, force=force) as output,
    ):
        reader = RecordingReader(handle)
        topic = source.topic or next((one.topic for one in _channels(reader)), "")
        chosen = _Chosen(reader, selection)
        if not chosen.any:
            raise SourceError(f"{path} has {selection.nothing()}: nothing was encoded")
        about = {name: text for name, text in reader.metadata.items() if name != "joined"}
        watched = Watched(chosen.stored(reader), stopped)
        with output.beside.open("wb") as to:
            writer = RecordingWriter(to, *named.known(source), None, about, clouds=clouds)
            frames = chosen.frames(again, topic or None, kept) if clouds else iter(())
            for channel, stored in watched:
                if not topic and channel.encoding == MESSAGE_ENCODING:
                    topic = channel.topic  # behind the packets of the recording
                if channel.encoding == REFINE_ENCODING and _sensor_of(channel.topic) == _sensor_of(topic):
                    writer.write_refinement(stored.data())
                    kept.size += stored.length
                elif channel.encoding == MESSAGE_ENCODING and channel.topic == topic and _copied(writer, stored, kept):
                    _points(writer, next(frames, []), path)
                    tick()
            if not watched.cut:
                for more in frames:
                    _points(writer, more, path)
            if reader.losses and chosen.all and not watched.cut and not kept.left_out:
                writer.write_losses(reader.losses)
            writer.close()
        if watched.cut:
            output.only_part()
    if kept.left_out:
        logger.warning("%s: %s were left out", path, counted(kept.left_out, "damaged message"))
    if kept.undecoded:
        logger.warning("%s: %s could not be decoded and have no points", path, counted(kept.undecoded, "message"))
    written = output.kept or out
    _tell(written, kept, chosen.earlier, clouds=clouds, as_json=as_json)
    if watched.cut:
        raise remaining.stopped(out, output.kept, kept.frames, skip=selection.skip, frames=selection.frames)


class _Chosen:
    """The messages that are taken. any: whether there are any;  earlier: frames that the first wanted one needs"""

    def __init__(self, reader: RecordingReader, selection: Selection) -> None:
        self._plan = None
        self.any, self.earlier = True, 0
        if selection != Selection():
            self._plan = planned(units_of(reader), selection, None)
            self.any, self.earlier = bool(self._plan.starts), self._plan.earlier

    @property
    def all(self) -> bool:
        """Whether all messages are taken."""
        return self._plan is None

    def stored(self, reader: RecordingReader) -> Iterator[tuple[Channel, Stored]]:
        """Every message of every channel that is taken, in the order of the file."""
        if self._plan is None:
            yield from reader.everything()
        else:
            yield from (item for _, item in numbered(reader, self._plan))

    def frames(self, handle: IO[bytes], topic: str | None, kept: _Kept) -> Iterator[list[Frame]]:
        """The frames of each message that can be decoded."""
        taken = None
        if self._plan is not None:
            copied = self.stored(RecordingReader(handle, warn=False))
            taken = {_frame_of(one) for channel, one in copied if channel.encoding == MESSAGE_ENCODING}

        def fail(error: DecodeError) -> None:
            kept.undecoded += 1

        decoder, reader = StreamDecoder(), RecordingReader(handle, warn=False)
        messages = (
            (stamp, data) for stamp, data in reader.messages(topic=topic) if taken is None or _number(data) in taken
        )
        for _, found in decoded(reader, messages, decoder.decode, fail):
            yield found
        yield list(decoder.flush())


def _channels(reader: RecordingReader) -> list[Channel]:
    """The channels of messages, the first one first."""
    found = [one for one in reader.channels.values() if one.encoding == MESSAGE_ENCODING]
    return sorted(found, key=lambda one: one.number)


def _sensor_of(topic: str) -> str:
    return topic.rpartition("/")[0]


def _number(data: bytes) -> tuple[int, int]:
    try:
        header = wire.peek(data)
    except DecodeError:
        return -1, -1
    return header.stream_id, header.frame_index


def _frame_of(stored: Stored) -> tuple[int, int]:
    return _number(stored.data(wire.HEADER_BYTES))


def _copied(writer: RecordingWriter, stored: Stored, kept: _Kept) -> bool:
    """Write a message and count it; False if it is damaged."""
    data = stored.data()
    try:
        message = wire.unpack(data)
    except DecodeError:
        kept.left_out += 1
        return False
    writer.write(data)
    kept.frames += message.frame_count
    kept.packets += message.packets
    kept.positions += sum(map(positions_of, message.sections))
    kept.size += len(data)
    return True


def _points(writer: RecordingWriter, frames: list[Frame], path: Path) -> None:
    for frame in frames:
        warn_if_generic(frame.sensor, str(path), path)
        writer.write_cloud(frame)


def _tell(out: Path, kept: _Kept, earlier: int, *, clouds: bool, as_json: bool) -> None:
    size = out.stat().st_size if out.is_file() else None
    found = Converted(
        output=str(out), form="recording", files=1, beside=[], frames=kept.frames, packets=kept.packets, points=None,
        positions=kept.positions, bytes=size, coded_bytes=kept.size,
    )  # fmt: skip
    before = f" ({earlier} of them before the first that was asked for, which needs them)" * bool(earlier)
    text = f"{out}: {counted(kept.frames, 'frame')}{before}, {kept.size:,} bytes of messages, kept as they are"
    tell(found, text + f"; with clouds the file has {size:,}" * clouds, as_json)

"""Joins recordings: copies messages byte for byte, in order. All parts must come from the same drive."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from shlex import quote
from typing import BinaryIO, Final

from lidarcodec import wire
from lidarcodec.assembly import packets_of
from lidarcodec.commands.join.overlap import Content, digest_of, digests_of
from lidarcodec.commands.progress import progress
from lidarcodec.commands.running.stopping import StoppedError, Watched, stoppable
from lidarcodec.commands.running.telling import tell
from lidarcodec.errors import DecodeError, SettingsError, SourceError
from lidarcodec.files.regular import open_regular
from lidarcodec.files.whole import whole
from lidarcodec.pipeline import StreamDecoder
from lidarcodec.recording import RecordingReader, RecordingWriter
from lidarcodec.recording.damage import is_damaged
from lidarcodec.recording.decoding_work import decoded
from lidarcodec.recording.layout import MESSAGE_ENCODING
from lidarcodec.recording.records import Channel, Stored
from lidarcodec.units import counted
from lidarcodec.wire.header import Header

SAME: Final = ("vehicle", "sensor", "mount")
"""Metadata that must be equal in all parts; see also `MADE_OF`."""
MADE_OF: Final = ("source", "calibration", "settings")
"""Metadata that must also be equal if the parts were made from a source. Settings of a live stream can change."""


@dataclass
class Part:
    """A recording to join. The fields of its first and last message are None if it holds packets."""

    path: Path
    handle: BinaryIO
    reader: RecordingReader
    first: Header | None = None
    last: Header | None = None
    first_ns: int = 0
    last_ns: int = 0
    gap: int = 0
    """Largest number of frames that are missing between two of its messages: a live stream skips some."""
    damaged: str = ""
    """Description of its damage; empty if there is none."""
    had: set[bytes] = field(default_factory=set)
    """Digests of what the part before it has, if they overlap: it is not copied again."""
    content: bytes = b""
    """Digest of all that was checked."""

    @property
    def counted(self) -> bool:
        """Whether the index of a frame is its position in the source."""
        return self.first is not None and "source" in self.reader.metadata


def run(paths: Sequence[Path], out: Path, allow_gap: bool, force: bool, as_json: bool = False) -> None:
    """Check the parts, then copy them."""
    with ExitStack() as files, stoppable() as stopped:
        parts = [_part(path, files.enter_context(open_regular(path))) for path in paths]
        for part in parts if not allow_gap else ():
            if part.damaged:
                raise SourceError(f"{part.path} {part.damaged}: use --allow-gap to join the rest")
        for part in parts:
            part.content = Content.of(part.reader.everything())
        for before, after in pairwise(parts):
            _check_kin(parts[0], after)
            _check_order(before, after, allow_gap)
        first = parts[0].reader.metadata
        clouds = any("/points" in channel.topic for part in parts for channel in part.reader.channels.values())
        count = twice = 0
        with whole(out, force=force) as output, progress("joining") as tick, output.beside.open("wb") as handle:
            about = {name: text for name, text in first.items() if name != "joined"} | {"joined": str(len(parts))}
            writer = RecordingWriter(handle, first["vehicle"], first["sensor"], None, about, clouds=clouds)
            watched = Watched(_everything(parts, out), stopped)
            for part, channel, stored, digest in watched:
                if digest in part.had:
                    twice += 1
                    continue
                writer.copy(channel, part.reader.schemas.get(channel.schema, ""), stored)
                count += 1
                tick()
            if watched.cut:
                raise StoppedError(f"stopped: {out} was not written, and the parts were not changed")
            writer.close()
    tell(
        {"output": str(output.kept), "beside": [], "parts": len(parts), "messages": count, "packets": None}
        | {"twice": twice},
        f"{output.kept}: {counted(count, 'message')} of {len(parts)} parts"
        + f"; {counted(twice, 'message')} that two parts have, written once" * (twice > 0),
        as_json,
    )


def _everything(parts: Sequence[Part], out: Path) -> Iterator[tuple[Part, Channel, Stored, bytes]]:
    """Every message of all parts, with its digest.

    Raises SourceError behind the last message of a part that is not any more what was checked.
    """
    for part in parts:
        content = Content()
        for channel, stored in part.reader.everything():
            digest = digest_of(channel, stored)
            content.add(digest)
            yield part, channel, stored, digest
        if content.told() != part.content:
            raise SourceError(
                f"{part.path} changed while it was joined, so {out} was not written: try again when no program "
                "changes the parts"
            )


def _part(path: Path, handle: BinaryIO) -> Part:
    """Raises SourceError if it is empty or not a recording of lidarcodec."""
    reader = RecordingReader(handle)
    if "vehicle" not in reader.metadata or "sensor" not in reader.metadata:
        raise SourceError(f"{path} is not a recording of lidarcodec: convert it first with `lidarcodec convert`")
    found = Part(path, handle, reader)
    quiet = RecordingReader(handle, warn=False)
    for _, data in quiet.messages():
        header = _header(path, data)
        if found.last is not None and found.last.stream_id == header.stream_id:
            found.gap = max(found.gap, header.frame_index - _behind(found.last))
        found.first = found.first or header
        found.last = header
    if quiet.counts["damaged"]:
        found.damaged = f"is damaged, and {quiet.counts['damaged']} of its chunks are lost"
    elif quiet.counts["cut"]:
        found.damaged = "was cut off, and its end is lost"
    elif number := sum(is_damaged(*one) for one in RecordingReader(handle, warn=False).everything()):
        found.damaged = f"has {counted(number, 'message')} that cannot be decoded"
    if found.first is not None and found.last is not None:
        found.first_ns, found.last_ns = found.first.stamp_ns, found.last.stamp_ns
        if not found.first.key:
            raise SourceError(f"{path} cannot be joined: its first message needs an earlier one")
        if not found.counted:
            found.last_ns = _last_packet_ns(quiet, found.last_ns)
        return found
    packets = quiet.packets()
    begin = next(packets, None)
    if begin is None:
        raise SourceError(f"{path} has no message: join the other parts without it")
    found.first_ns = found.last_ns = begin.stamp_ns
    for packet in packets:
        found.last_ns = max(found.last_ns, packet.stamp_ns)
    return found


def _header(path: Path, data: bytes) -> Header:
    try:
        return wire.peek(data)
    except DecodeError as error:
        raise SourceError(f"{path} has a message that cannot be read: {error}") from None


def _last_packet_ns(reader: RecordingReader, last_ns: int) -> int:
    """Time of the last packet of the last frame that can be decoded."""
    failed: list[DecodeError] = []
    for _, frames in decoded(reader, reader.messages(last_ns), StreamDecoder().decode, failed.append):
        for frame in frames:
            if frame.side is not None:
                last_ns = max(last_ns, packets_of(frame)[-1].stamp_ns)
    return last_ns


def _check_kin(first: Part, other: Part) -> None:
    """Raises SettingsError if the parts do not come from the same drive."""
    ours, theirs = first.reader.metadata, other.reader.metadata
    names = [*SAME, *(MADE_OF if "source" in ours or "source" in theirs else ())]
    for name in names:
        if _plain(name, ours.get(name)) != _plain(name, theirs.get(name)):
            told = _differences(ours.get(name), theirs.get(name))
            way = "; code them both from one source" * (name == "source") or "; code them with the same" * (
                name == "settings"
            )
            raise SettingsError(
                f"{first.path} and {other.path} differ in {name} ({told}): only parts of the same drive can be joined"
                f"{way}", name
            )  # fmt: skip
    if (first.first is None) != (other.first is None):
        raise SettingsError(f"{first.path} and {other.path} cannot be joined: one holds messages, the other packets")


def _differences(ours: str | None, theirs: str | None) -> str:
    """Both values; of settings only those that differ.

    >>> _differences('{"codec":"png","max_error_m":null}', '{"codec":"png","max_error_m":0.02}')
    'max_error_m: null and 0.02'
    >>> _differences("a.pcap", None)
    'a.pcap and none'
    """
    try:
        one, other = (json.loads(text or "") for text in (ours, theirs))
    except ValueError:
        one = other = None
    if not isinstance(one, dict) or not isinstance(other, dict):
        return f"{ours or 'none'} and {theirs or 'none'}"
    names = [name for name in {**one, **other} if one.get(name) != other.get(name)]
    return ", ".join(f"{name}: {json.dumps(one.get(name))} and {json.dumps(other.get(name))}" for name in names)


def _plain(name: str, text: str | None) -> str | None:
    if name == "source" and text is not None and not text.startswith("sim:") and "://" not in text:
        return os.path.normpath(text)
    return text


def _behind(message: Header) -> int:
    """The index after the last frame of a message."""
    return message.frame_index + message.frame_count


def _are_counted(before: Part, after: Part) -> bool:
    """Whether both were made from a source, without skipped frames."""
    return before.counted and after.counted


def _check_order(before: Part, after: Part, allow_gap: bool) -> None:
    """Raises SettingsError if the second part does not come after the first, or frames are missing between them."""
    last, first = before.last, after.first
    if last is not None and first is not None and (_are_counted(before, after) or first.stream_id == last.stream_id):
        next_index = _behind(last)
        if first.frame_index < next_index:
            _check_overlap(before, after, next_index)
            return
        usual = 0 if _are_counted(before, after) else max(before.gap, after.gap)
        if first.frame_index - next_index > usual and not allow_gap:
            raise SettingsError(
                f"frames {next_index} to {first.frame_index - 1} are missing between {before.path} and "
f"{after.path}: add the missing part, or use --allow-gap", "allow_gap"
            )  # fmt: skip
    elif after.first_ns < before.last_ns:
        raise SettingsError(
            f"{after.path} begins before {before.path} ends: give the parts in order, and without overlap"
        )


def _check_overlap(before: Part, after: Part, next_index: int) -> None:
    """Note what both parts have, so that it is written once: `cut` begins a part with a key frame, earlier than asked.

    Raises SettingsError if the second part does not go on from the first, or was coded apart from it.
    """
    if after.first is None or after.last is None:
        return
    begins = (
        f"{after.path} begins with frame {after.first.frame_index}, but {before.path} ends with frame {next_index - 1}"
    )
    if _behind(after.last) <= next_index:
        raise SettingsError(f"{begins}: give the parts in order, and without overlap")
    had = digests_of(RecordingReader(before.handle, warn=False).everything())
    for channel, stored in RecordingReader(after.handle, warn=False).everything():
        if channel.encoding != MESSAGE_ENCODING or digest_of(channel, stored) in had:
            continue
        if _header(after.path, stored.data()).frame_index < next_index:
            source = quote(after.reader.metadata.get("source", ""))
            way = f", for example `lidarcodec encode {source} PART.mcap --skip {next_index}` with the same settings"
            raise SettingsError(
                f"{begins}, and what both have was not coded at once: give parts without overlap{way * after.counted}"
            )
    after.had = had

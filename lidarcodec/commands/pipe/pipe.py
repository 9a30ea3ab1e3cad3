"""`lidarcodec pipe`: reads packets or messages, and writes packets, messages, a recording or points as they come."""

from __future__ import annotations

import contextlib
import fcntl
import logging
import os
import stat
import sys
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Final, TypeVar

from lidarcodec import wire
from lidarcodec.cloud import second_returns_text
from lidarcodec.commands.pipe import inputs
from lidarcodec.commands.pipe.outputs import Captured, Clouds, FrameOutput, MessageOutput, Prefixed, Recorded
from lidarcodec.commands.results.files import Piped
from lidarcodec.commands.running.stopping import stoppable
from lidarcodec.commands.running.telling import tell
from lidarcodec.commands.settings import one_setting
from lidarcodec.commands.signatures.common import of_model
from lidarcodec.errors import DecodeError, SettingsError, SourceError, UnknownNameError
from lidarcodec.evaluation.coded_recording import SENSOR, VEHICLE
from lidarcodec.files.counting import Counting
from lidarcodec.files.regular import open_regular
from lidarcodec.frame import Frame
from lidarcodec.pipeline import StreamDecoder, StreamEncoder, check_offline, frames_of
from lidarcodec.recording import RecordingReader
from lidarcodec.recording.decoding_work import decoded
from lidarcodec.settings import is_name
from lidarcodec.sources import PacketSource, open_source
from lidarcodec.sources.posed import with_poses
from lidarcodec.sources.spec import parse
from lidarcodec.sources.table import kind_of
from lidarcodec.sources.unkept import say_unkept

logger = logging.getLogger(__name__)

STANDARD: Final = "-"
OF_MESSAGES: Final = ("messages", "recording")
OF_FRAMES: Final = ("pcap", "points")
FORMS: Final = (*OF_MESSAGES, *OF_FRAMES)

Item = TypeVar("Item")
Stop = Callable[[], bool]


@dataclass
class _Done:
    """Counts of what went through.

    lost: messages or frames that could not be passed on;  damaged: places where the input is
        damaged, or a recording cut
    points: None where none are written
    second: second returns left out of the points
    """

    frames: int = 0
    lost: int = 0
    damaged: int = 0
    points: int | None = None
    second: int = 0


@dataclass
class _Feed:
    """What comes in: packets, the messages of a recording, or others. most: frames to take; None: all of them

    coded: ends by itself after a signal, as the packets of a live source do
    names: vehicle and sensor, where the input says them
    failed: why the input ended early. What came before is written first
    """

    stopped: Stop
    most: int | None
    source: PacketSource | None = None
    recording: RecordingReader | None = None
    coded: Iterable[bytes] = ()
    names: tuple[str, str] = (VEHICLE, SENSOR)
    failed: SourceError | None = None

    def till_failure(self, items: Iterable[Item]) -> Iterator[Item]:
        """The items; a SourceError ends them, and is kept."""
        try:
            yield from items
        except SourceError as error:
            self.failed = error

    def messages(self) -> Iterator[bytes]:
        """Messages as they are; of a recording those of the base alone."""
        return iter(self.coded) if self.recording is None else _until(_base(self.recording), self.stopped)

    def frames(self, framing: str, done: _Done) -> Iterator[Frame]:
        """Frames of packets, or decoded."""
        source = self.source
        if self.recording is not None:
            return islice(_until(_recorded(self.recording, done), self.stopped), self.most)
        if source is None:
            return islice(_decoded(self.coded, done), self.most)
        packets = self.till_failure(source.packets())
        cut = frames_of(packets, source.sensor, framing, source.counts, current=lambda: source.sensor)
        cut = with_poses(cut, source.carried, source.mount)
        return islice(cut if source.live else _until(cut, self.stopped), self.most)


def run(
    spec: str,
    form: str,
    codec: str | None,
    pairs: list[str],
    frames: int | None,
    calibration: Path | None,
    model: str | None,
    *,
    as_json: bool,
    standard: tuple[int, int] = (0, 1),
) -> None:
    """Pass everything on until the input ends or a signal comes. What was written is complete then.

    spec: a source, or `-` for standard input;  codec, pairs: None and []: messages are passed on as they are
    standard: descriptors of standard input and output
    Raises SourceError if the reader of standard output goes away, the input ends early, or not all could be passed on,
    SettingsError if `frames` end within a message that is passed on as it is.
    """
    settings = check_offline(one_setting(codec, pairs))
    recodes = codec is not None or bool(pairs)
    _check(spec, form, recodes, standard)
    done, out = _Done(), Counting(os.fdopen(os.dup(standard[1]), "wb"))
    try:
        with _opened(spec, frames, calibration, model, standard[0], points=form == "points") as feed:
            if form in OF_FRAMES:
                frame_writer = Captured(out) if form == "pcap" else Clouds(out)
                _write_frames(feed.frames(settings.framing, done), frame_writer, done)
                if isinstance(frame_writer, Clouds):
                    done.points, done.second = frame_writer.points, frame_writer.second
            else:
                writer: MessageOutput = Prefixed(out) if form == "messages" else Recorded(out, *feed.names)
                if recodes or feed.source is not None:
                    _write_messages(
                        _encoded(feed.frames(settings.framing, done), StreamEncoder(settings)), writer, done
                    )
                else:
                    _write_messages(feed.messages(), writer, done, frames)
            out.flush()
            if feed.source is not None:
                say_unkept(feed.source.label, feed.source.counts)
                done.damaged = feed.source.counts["damaged"]
                done.lost += feed.source.counts["undecoded messages"] + feed.source.counts["missing references"]
            if feed.recording is not None:
                done.damaged = feed.recording.counts["damaged"] + feed.recording.counts["cut"]
    except BrokenPipeError:
        raise SourceError(f"the reader of standard output went away after {done.frames} frames") from None
    finally:
        out.close()
    if feed.failed is not None:
        raise SourceError(f"{feed.failed}; {done.frames} frames before that were passed on") from feed.failed
    if not done.frames:
        raise SourceError(f"{inputs.NAME if spec == STANDARD else spec} has no frame that can be passed on")
    if done.lost or done.damaged:  # all else was passed on
        raise SourceError(_lacking(done))
    found = Piped(format=form, frames=done.frames, bytes=out.bytes, lost=done.lost)
    text = f"{done.frames} frames, {out.bytes:,} bytes of {form}"
    if done.points is not None:
        found["points"], text = done.points, f"{done.frames} frames, {done.points:,} points, {out.bytes:,} bytes"
    if done.second:
        found["second_returns_left_out"] = done.second
        text += f", {second_returns_text(done.second)}"
    with contextlib.redirect_stdout(sys.stderr):  # standard output is for the frames
        tell(found, text, as_json)


def _lacking(done: _Done) -> str:
    lacking = [f"{done.lost} messages or frames could not be passed on"] if done.lost else []
    if done.damaged:
        lacking.append("the input is damaged, or a recording that was cut, and what it has lost is missing")
    return f"{'; '.join(lacking)}; {done.frames} frames were passed on"


def _check(spec: str, form: str, recodes: bool, standard: tuple[int, int]) -> None:
    if form not in FORMS:
        raise UnknownNameError("format", form, FORMS)
    if recodes and form in OF_FRAMES:
        raise SettingsError(
            f"--codec and --set are only for messages and recordings: leave them out for {form}", "codec"
        )
    if os.isatty(standard[1]):
        raise SettingsError("standard output is a terminal: pipe it into a program or a file", "to")
    if _is_nowhere(standard[1]):
        raise SettingsError("standard output is closed: pipe it into a program or a file", "to")
    if spec == STANDARD and os.isatty(standard[0]):
        raise SettingsError(f"{inputs.NAME} is a terminal: pipe a capture or messages into it, or name a SOURCE")


def _is_nowhere(descriptor: int) -> bool:
    """Whether standard output was closed (`>&-`): the null device, open for reading and writing, is in its place."""
    about, access = os.fstat(descriptor), fcntl.fcntl(descriptor, fcntl.F_GETFL) & os.O_ACCMODE
    return access == os.O_RDWR and stat.S_ISCHR(about.st_mode) and about.st_rdev == Path(os.devnull).stat().st_rdev


@contextlib.contextmanager
def _opened(
    spec: str, most: int | None, calibration: Path | None, model: str | None, descriptor: int, *, points: bool
) -> Iterator[_Feed]:
    """What comes in, opened. A signal ends it behind a frame.

    descriptor: of standard input;  points: whether points are made
    """
    with contextlib.ExitStack() as stack:
        feed = _Feed(lambda: False, most)
        feed.stopped = stack.enter_context(stoppable(lambda: _finish(feed.source)))
        if spec == STANDARD:
            given = inputs.Input(descriptor, feed.stopped)
            if inputs.is_messages(given):
                feed.coded = feed.till_failure(inputs.messages(given))
            else:
                feed.source = stack.enter_context(inputs.capture(given, calibration, model))
        else:
            _open_recording(feed, spec, stack)
            if feed.recording is None:
                feed.source = stack.enter_context(
                    open_source(of_model(spec, model), calibration=calibration, points=points)
                )
        for name, value in (("--calibration", calibration), ("--model", model)):
            if feed.source is None and value is not None:
                raise SettingsError(
                    f"{name} is only for packets: messages carry their own sensor and calibration", name.lstrip("-")
                )
        yield feed


def _finish(source: PacketSource | None) -> None:
    if source is not None and source.live:
        source.finish()


def _open_recording(feed: _Feed, spec: str, stack: contextlib.ExitStack) -> None:
    """Take the names of a recording, and its messages if there are any and no options say what is read."""
    parsed = parse(spec)
    if kind_of(parsed) != "recording":
        return
    reader = RecordingReader(stack.enter_context(open_regular(parsed.path)))
    names = reader.metadata.get("vehicle", ""), reader.metadata.get("sensor", "")
    if all(map(is_name, names)):
        feed.names = names
    if not parsed.options and next(reader.messages(), None) is not None:
        feed.recording = reader


def _write_frames(frames: Iterable[Frame], writer: FrameOutput, done: _Done) -> None:
    for frame in frames:
        if writer.write(frame):
            done.frames += 1
        else:
            done.lost += 1


def _write_messages(coded: Iterable[bytes], writer: MessageOutput, done: _Done, most: int | None = None) -> None:
    """Write all messages, or those of so many frames. Raises SettingsError, behind whole ones, if these end in one."""
    for data in coded:
        try:
            frames = wire.unpack(data).frame_count
        except DecodeError:
            done.lost += 1
            continue
        if most is not None and done.frames + frames > most:
            writer.close()
            raise _ends_within(most, done.frames, frames)
        writer.write(data)
        done.frames += frames
        if done.frames == most:
            break
    writer.close()


def _ends_within(most: int, before: int, frames: int) -> SettingsError:
    fit = " or ".join(str(count) for count in (before, before + frames) if count)
    return SettingsError(
        f"--frames {most} falls inside a message of {frames} frames: give --frames {fit}, or --codec to code it again",
        "frames",
    )


def _decoded(coded: Iterable[bytes], done: _Done) -> Iterator[Frame]:
    decoder = StreamDecoder()
    for data in coded:
        try:
            frames = decoder.decode(wire.unpack(data))
        except DecodeError:
            done.lost += 1
            continue
        yield from frames
    yield from decoder.flush()


def _recorded(reader: RecordingReader, done: _Done) -> Iterator[Frame]:
    """Frames of a recording, with their refinements."""

    def fail(error: DecodeError) -> None:
        done.lost += 1

    decoder = StreamDecoder()
    for _, frames in decoded(reader, reader.messages(), decoder.decode, fail):
        yield from frames
    yield from decoder.flush()


def _base(reader: RecordingReader) -> Iterator[bytes]:
    """Messages of a recording. Warns if it also has refinements, which are not among them."""
    for _, data in reader.messages():
        yield data
    if refinements := reader.refinements.untaken():
        logger.warning(
            "%d refinements were left out: the output holds the base of these frames, within base_error_m", refinements
        )


def _encoded(frames: Iterable[Frame], encoder: StreamEncoder) -> Iterator[bytes]:
    for frame in frames:
        yield from (wire.pack(message) for message in encoder.encode(frame))
    yield from (wire.pack(message) for message in encoder.flush())


def _until(items: Iterable[Item], stopped: Stop) -> Iterator[Item]:
    """The items until a signal comes."""
    for item in items:
        if stopped():
            return
        yield item

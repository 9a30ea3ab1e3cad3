"""Writes frames of a source in a format of `commands/outputs`: for `convert`, and `decode` as its short form."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import Final, Protocol

from lidarcodec.apps.receiver.live_stream import LiveStream
from lidarcodec.cloud import second_returns, second_returns_text
from lidarcodec.commands.capture_records import named_beside, said_beside
from lidarcodec.commands.convert.described import check_beside, write_beside
from lidarcodec.commands.outputs.base import NO_CLOUD, USUAL, BagNames, Output
from lidarcodec.commands.outputs.pcap import PcapOutput
from lidarcodec.commands.outputs.table import Form, check_output, check_returns, contents_of, opened
from lidarcodec.commands.progress import progress
from lidarcodec.commands.results.files import Converted
from lidarcodec.commands.running import remaining
from lidarcodec.commands.running.stopping import Watched, stoppable
from lidarcodec.commands.running.telling import tell
from lidarcodec.commands.selection.frames import Selection
from lidarcodec.commands.selection.points import Placing
from lidarcodec.commands.sources import check_finite, check_not_input
from lidarcodec.commands.subscribe import awaited
from lidarcodec.commands.unkept import positions_in, positions_text
from lidarcodec.errors import SettingsError, SourceError
from lidarcodec.evaluation.recorded import RecordedFrames
from lidarcodec.files.whole import Whole, whole
from lidarcodec.frame import Frame
from lidarcodec.mounting import Mounting
from lidarcodec.pipeline import frames_of
from lidarcodec.recording.layer_counts import LAYERS
from lidarcodec.sensors.models.table import PACKETS
from lidarcodec.settings import StreamSettings
from lidarcodec.sources import PacketSource, open_source
from lidarcodec.sources.mounts import NOT_SAID, Mounted
from lidarcodec.sources.posed import with_poses
from lidarcodec.sources.recording import is_thinned
from lidarcodec.sources.spec import parse
from lidarcodec.sources.table import kind_of
from lidarcodec.sources.unit_calibration import warn_if_generic
from lidarcodec.sources.unkept import say_unkept
from lidarcodec.transport import Endpoints
from lidarcodec.units import counted

logger = logging.getLogger(__name__)
INSTEAD: Final = "; `convert` makes a rosbag2 of a folder, --as FORMAT other files"
REMEDY: Final = "--returns all"
APART: Final = "The points of each frame are relative to where the sensor was then"
BY_POSES: Final = ": add --merge to place them by poses"


@dataclass(frozen=True)
class Wanted:
    """What is to be written. form: its format;  selection: which frames;  placing: where points lie

    chosen: whether the form was, instead of that of any folder;  names: in a bag
    """

    out: Path
    form: Form
    selection: Selection = field(default_factory=Selection)
    placing: Placing = field(default_factory=Placing)
    force: bool = False
    as_json: bool = False
    chosen: bool = True
    names: BagNames = USUAL

    def check(self) -> None:
        """Raise SettingsError or MissingExtraError for what cannot be written, before anything is read."""
        given = self.placing.placed if self.form.is_bag else self.placing.given
        if given and not self.form.points:
            raise SettingsError(
                f"{given} is only for files of points, such as .ply: {self.form.name} is written without it"
            )
        check_returns(self.form, self.placing.returns)
        if self.placing.merge and contents_of(self.out, self.form) is not None:
            raise SettingsError("--merge puts all frames into one file: give OUT an ending, such as .ply", "merge")
        check_output(self.out, self.form, force=self.force)


class Frames(Protocol):
    """Frames to write. live: whether they come from a sensor;  finish: end them;  say: warn about what was left out

    posed: whether the source has poses, beside those of its frames
    """

    live: bool
    posed: bool

    def __iter__(self) -> Iterator[Frame]: ...

    def finish(self) -> None: ...

    def say(self) -> None: ...


class _Recorded:
    """Frames of a recording, as its messages say. A cut or damaged recording gives all complete frames."""

    live = posed = False

    def __init__(self, path: Path, poses: Path | None, mounted: Mounted, *, points: bool) -> None:
        """points: whether points are made of the frames"""
        self._path, self._points = path, points
        self._recorded = RecordedFrames(path, ": `lidarcodec convert` takes captures and other sources")
        self._poses, self._mount = None, mounted.mount
        self._counts: Counter[str] = Counter()
        if poses is not None:
            with open_source(path, poses=poses, points=False) as source:
                mounted.given_to(source)
                self._poses = source.poses

    def __iter__(self) -> Iterator[Frame]:
        for frame in with_poses(self._recorded, self._poses, self._mount):
            if self._points:
                warn_if_generic(frame.sensor, str(self._path), self._path)
            if self._recorded.message is not None and is_thinned(self._recorded.message):
                self._counts["thinned frames"] += 1
            yield frame

    def finish(self) -> None:
        """A recording ends by itself."""

    def say(self) -> None:
        say_unkept(str(self._path), self._counts)
        for text in self._recorded.warnings():
            logger.warning("%s", text)
        layers = self.layers
        if layers and (layers["part"] or layers["base"]):
            text = self._recorded.layers_text()
            logger.warning("%s: %s; all other frames have only the larger error bound base_error_m", self._path, text)

    @property
    def layers(self) -> dict[str, int] | None:
        """How many frames were refined; None for a recording of one layer."""
        found = self._recorded.layers
        return {name: found[name] for name in LAYERS} if found else None


class _Read:
    """Frames of any other source. posed: whether to take its poses, beside those that its messages carry"""

    def __init__(self, source: PacketSource, *, posed: bool) -> None:
        self._source, self._take_poses = source, posed
        self.live, self.posed = source.live, source.poses is not None

    def __iter__(self) -> Iterator[Frame]:
        source = self._source
        framing = StreamSettings().framing
        cut = frames_of(source.packets(), source.sensor, framing, source.counts, current=lambda: source.sensor)
        poses = source.poses if self._take_poses else None
        return with_poses(cut, poses or source.carried, source.mount)

    def finish(self) -> None:
        self._source.finish()

    def say(self) -> None:
        say_unkept(self._source.label, self._source.counts)


class _Streamed:
    """Decoded frames of a live stream over Zenoh, until its publisher stops. None is skipped, which slows it down."""

    live, posed = True, False

    def __init__(self, stream: LiveStream, key: str, mount: Mounting | None) -> None:
        self._stream, self._key, self._mount = stream, key, mount

    def __iter__(self) -> Iterator[Frame]:
        return with_poses(awaited(self._stream, self._key), None, self._mount)

    def finish(self) -> None:
        self._stream.interrupt()

    def say(self) -> None:
        missing = self._stream.summary().get("missing", 0)
        if missing:
            logger.warning("%s: %d frames of the stream did not arrive", self._key, missing)


def receive(key: str, wanted: Wanted, endpoints: Endpoints, mount: Mounting | None = None) -> None:
    """Write frames of a live stream. key: VEHICLE/SENSOR;  mount: in place of what the stream says"""
    wanted.check()
    with LiveStream(key, endpoints=endpoints, newest=False, until_end=True) as stream:
        _write(key, _Streamed(stream, key, mount), wanted)


@contextmanager
def frames_of_source(
    spec: str,
    calibration: Path | None,
    poses: Path | None = None,
    mounted: Mounted = NOT_SAID,
    *,
    posed: bool = False,
    points: bool = True,
) -> Iterator[Frames]:
    """Frames of any source. Of a recording of messages they are the decoded frames.

    posed: whether to take its poses;  points: whether points are made of them
    """
    parsed = parse(spec)
    if kind_of(parsed) == "recording" and not parsed.options and calibration is None:
        yield _Recorded(parsed.path, poses, mounted, points=points)
        return
    with open_source(spec, calibration=calibration, poses=poses, points=points) as source:
        mounted.given_to(source)
        yield _Read(source, posed=posed)


def convert(
    spec: str, wanted: Wanted, calibration: Path | None, poses: Path | None, mounted: Mounted = NOT_SAID
) -> None:
    """Write frames of any source. Of a recording of messages they are the decoded frames."""
    wanted.check()
    check_finite(spec, wanted.selection.frames, live_too=False)
    check_not_input(wanted.out, spec)
    posed = wanted.placing.merge or poses is not None
    points = wanted.form.first_returns
    with frames_of_source(spec, calibration, poses, mounted, posed=posed, points=points) as frames:
        _write(spec, frames, wanted)


def decode(recording: Path, wanted: Wanted, poses: Path | None = None, mounted: Mounted = NOT_SAID) -> None:
    """Write the frames of a recording."""
    check_not_input(wanted.out, recording)
    wanted.check()
    _write(str(recording), _Recorded(recording, poses, mounted, points=wanted.form.first_returns), wanted)


@dataclass
class _Written:
    """Numbers of what was written."""

    frames: int = 0
    points: int = 0
    positions: int = 0
    second_returns: int = 0
    returns: int = 0
    columns: int = 0
    packets: int | None = None
    posed: bool = False
    model: str = ""
    ending: str | None = None


def _write(name: str, source: Frames, wanted: Wanted) -> None:
    out, selection = wanted.out, wanted.selection
    with (
        progress("converting", selection.frames) as tick,
        stoppable(source.finish if source.live else None) as stopped,
        whole(out, force=wanted.force, contents=contents_of(out, wanted.form)) as output,
    ):
        # A signal ends a live source; the packets received so far are the last frame.
        watched = Watched(source, (lambda: False) if source.live else stopped)
        chosen = selection.of(watched)
        first = next(chosen, None)
        if first is None and stopped():
            raise remaining.stopped(out, None, 0)
        if first is None:
            source.say()
            raise SourceError(f"{name} has {selection.nothing()} that can be decoded: {out} was not written")
        written = _Written(posed=source.posed)
        capture = wanted.form.name == "pcap" and not output.straight
        if capture:
            check_beside(out, first.sensor, force=wanted.force)
        sensor = first.sensor
        with opened(wanted.out, wanted.form, output.beside, wanted.names, wanted.placing.returns) as writer:
            for frame in chain((first,), chosen):
                _put(writer, frame, wanted, written)
                sensor = frame.sensor
                tick()
            written.packets = writer.packets if isinstance(writer, PcapOutput) else None
        if wanted.form.first_returns and not written.returns:
            raise _without_points(name, out, frame.sensor.model, written)
        part = watched.cut or (
            source.live and stopped() and selection.frames is not None and written.frames < selection.frames
        )
        if capture and (found := check_beside(out, sensor, force=wanted.force)) is not None:
            write_beside(output, found)
            written.ending = found[0]
        if part:
            output.only_part()
    source.say()
    _tell(output, wanted, written, source.layers if isinstance(source, _Recorded) else None)
    if part:
        raise remaining.stopped(
            out, output.kept, written.frames, skip=selection.skip, frames=selection.frames, live=source.live
        )


def _put(writer: Output, frame: Frame, wanted: Wanted, written: _Written) -> None:
    cloud = wanted.placing.points(frame) if wanted.form.points else NO_CLOUD
    writer.write(frame, cloud)
    written.frames += 1
    written.model, written.posed = frame.sensor.model, written.posed or frame.pose is not None
    written.returns, written.columns = written.returns + frame.points, written.columns + frame.width
    second = second_returns(frame) if wanted.form.first_returns else 0
    all_of = frame.points + second * (wanted.placing.returns == "all")
    written.points += len(cloud) if wanted.form.points else all_of
    written.positions += positions_in(frame)
    written.second_returns += second * (wanted.placing.returns == "first")


def _without_points(name: str, out: Path, model: str, written: _Written) -> SourceError:
    """The error for frames without any return."""
    if written.columns:
        return SourceError(f"{name} has no returns in {counted(written.frames, 'frame')}: {out} was not written")
    if model == PACKETS:
        return SourceError(f"--model {PACKETS} takes packets as they are, without points: {out} was not written")
    place = name.partition("?")[0]
    return SourceError(
        f"no packet of {place} is one of the model {model}, so there are no points: {out} was not written. Leave "
        "--model out, and the sensor is recognised"
    )


def _tell(output: Whole, wanted: Wanted, written: _Written, layers: dict[str, int] | None) -> None:
    kept = output.kept or wanted.out
    folder = kept.is_dir()
    beside = [] if written.ending is None else [named_beside(kept, written.ending)]
    found = Converted(
        output=str(kept), form=wanted.form.name, files=sum(1 for _ in kept.iterdir()) if folder else 1,
        beside=[str(one) for one in beside],
        frames=written.frames, packets=written.packets, points=written.points, positions=written.positions,
        bytes=kept.stat().st_size if kept.is_file() else None,
    )  # fmt: skip
    if layers is not None:
        found["layers"] = layers
    if written.second_returns:
        found["second_returns_left_out"] = written.second_returns
    files = f", a file for each ({wanted.form.name}{'' if wanted.chosen else INSTEAD})" if folder else ""
    files = ", a rosbag2" if folder and wanted.form.is_bag else files
    packets = "" if written.packets is None else f", {counted(written.packets, 'packet')}"
    text = f"{kept}: {counted(written.frames, 'frame')}{packets}{files}, {counted(written.points, 'point')}"
    if written.second_returns:
        text += f", {second_returns_text(written.second_returns, REMEDY * wanted.form.numbered)}"
    text += positions_text(wanted.out, written.positions, written.model)
    text += "".join(f"; {said_beside(one)}" for one in beside)
    if wanted.form.points and written.frames > 1 and not folder and not wanted.placing.merge:
        text += f". {APART}{BY_POSES * written.posed}"
    tell(found, text, wanted.as_json)

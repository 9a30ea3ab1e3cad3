"""`lidarcodec archive get`: frames of an archive as packets, as a recording, or as clouds."""

from __future__ import annotations

import logging
import re
from collections.abc import Callable, Iterator
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any, Final, NamedTuple

from lidarcodec.archive.archive import Archive, open_archive, time_ns
from lidarcodec.archive.contents import commits_of
from lidarcodec.archive.messages import Coded
from lidarcodec.archive.names import Commit
from lidarcodec.archive.table import check_extra
from lidarcodec.cloud import second_returns, second_returns_text
from lidarcodec.commands.outputs.base import NO_CLOUD
from lidarcodec.commands.outputs.table import SCANS, check_output, check_returns, contents_of, form_of, opened
from lidarcodec.commands.progress import progress
from lidarcodec.commands.running.stopping import StoppedError, Watched, stoppable
from lidarcodec.commands.running.telling import tell
from lidarcodec.commands.selection.points import Placing
from lidarcodec.errors import SettingsError, SourceError
from lidarcodec.files.whole import Whole, check_free, whole
from lidarcodec.recording import RecordingWriter
from lidarcodec.units import counted
from lidarcodec.untrusted.times import rfc_3339

logger = logging.getLogger(__name__)

RECORDING: Final = ".mcap"
FOLDER: Final = "kitti"
"""Format of the files in a folder."""
LATEST_NS: Final = (1 << 63) - 1
_PLACE: Final = re.compile(r"\b[xyz]\b")
"""Columns with the place of a frame."""


Stopped = Callable[[], bool]
Tick = Callable[[], None]


class Which(NamedTuple):
    """Which frames: options of the command."""

    vehicle: str | None
    sensor: str | None
    first: str | None
    last: str | None
    where: str | None

    def arguments(self) -> dict[str, Any]:
        """Arguments of `Archive.frames`. Raises SettingsError."""
        between = None
        if self.first is not None or self.last is not None:
            first = 0 if self.first is None else time_ns(self.first)
            between = first, LATEST_NS if self.last is None else time_ns(self.last)
        return {"vehicle": self.vehicle, "sensor": self.sensor, "between": between, "where": self.where}


def run(archive: str, out: Path, which: Which, returns: str, force: bool, as_json: bool) -> None:
    """Fetch, decode and write. OUT appears when it is complete.

    returns: as for Placing.of
    Raises SourceError if there is no such frame, or tables are lost that a condition needs; OUT has the others then.
    """
    placing = Placing.of(None, None, merge=False, returns=returns)
    arguments = which.arguments()
    if which.where is not None:
        check_extra("--where")
    is_recording = out.suffix.lower() == RECORDING
    contents = None
    if is_recording:
        check_free(out, force=force)
    else:
        form = form_of(out, folder=FOLDER, each=SCANS)
        contents = contents_of(out, form)
        check_output(out, form, force=force)
        check_returns(form, placing.returns)
    store = open_archive(archive)
    with (
        stoppable() as stopped,
        progress("fetching") as tick,
        whole(out, force=force, contents=contents) as output,
    ):
        write = _recording if is_recording else partial(_frames, placing=placing)
        frames, cut = write(store, arguments, out, output, stopped, tick)
        if cut:
            raise StoppedError(f"stopped: {out} was not written")
    if store.lost:
        raise SourceError(
            f"{output.kept} has {counted(frames, 'frame')}, but --where could not see those of "
            f"{counted(store.lost, 'segment')} whose tables are lost: `archive run --repair` makes them again from "
            "their inputs"
        )
    tell({"output": str(output.kept), "frames": frames}, f"{output.kept}: {counted(frames, 'frame')}", as_json)


def _frames(
    store: Archive, arguments: dict[str, Any], out: Path, output: Whole, stopped: Stopped, tick: Tick, placing: Placing
) -> tuple[int, bool]:
    """Write decoded frames. Returns their number, and whether a signal ended it."""
    watched = Watched(store.decoded(**arguments), stopped)
    found = iter(watched)
    first = _first(found, store, arguments)
    form, count, second = form_of(out, folder=FOLDER, each=SCANS), 0, 0
    with opened(out, form, output.beside, returns=placing.returns) as writer:
        for commit, frame in chain((first,), found):
            _same_stream(first[0], commit)
            writer.write(frame, placing.points(frame) if form.points else NO_CLOUD)
            count += 1
            second += second_returns(frame) if form.first_returns and placing.returns == "first" else 0
            tick()
    if second:
        logger.warning("%s: %s", out, second_returns_text(second, "--returns all" * form.numbered))
    return count, watched.cut


def _recording(
    store: Archive, arguments: dict[str, Any], out: Path, output: Whole, stopped: Stopped, tick: Tick
) -> tuple[int, bool]:
    """The messages as they are, with those before them that decoding needs."""
    del out
    watched: Watched[Coded] = Watched(store.messages(**arguments), stopped)
    found = iter(watched)
    first, count = _first(found, store, arguments), 0
    names = first.commit.vehicle, first.commit.sensor
    with output.beside.open("wb") as file, RecordingWriter(file, *names) as writer:
        for one in chain((first,), found):
            _same_stream(first.commit, one.commit)
            writer.write(one.data)
            count += one.place.frames
            tick()
    return count, watched.cut


def _first(found: Iterator[Any], store: Archive, arguments: dict[str, Any]) -> Any:
    first = next(found, None)
    if first is None:
        raise SourceError(f"no frame in the archive fits these options{_why(store, arguments)}: nothing was written")
    return first


def _why(store: Archive, arguments: dict[str, Any]) -> str:
    """What an archive has instead of the frames that were asked for, in parentheses; empty if that explains nothing."""
    if (where := arguments["where"]) is not None:
        asked = _PLACE.search(where)
        if asked is None or store.query("SELECT count(x) FROM frames")[1][0][0]:
            return ""
        return f" (no frame has a known pose, so {asked[0]} is null)"
    commits = commits_of(store.store, arguments["vehicle"], arguments["sensor"])
    if arguments["between"] is None or not commits:
        return ""
    first, last = min(one.first_ns for one in commits), max(one.last_ns for one in commits)
    return f" (there are frames from {rfc_3339(first)} to {rfc_3339(last)})"


def _same_stream(one: Commit, other: Commit) -> None:
    if one[:2] != other[:2]:
        raise SettingsError(
            f"there are frames of {one.vehicle}/{one.sensor} and of {other.vehicle}/{other.sensor}: choose one with "
            "--vehicle and --sensor"
        )

"""`lidarcodec decode`: writes a recording as packets, images or points."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from itertools import chain, islice
from pathlib import Path

from lidarcodec.commands.outputs import Output, check_output, contents_of, open_output
from lidarcodec.commands.progress import progress
from lidarcodec.commands.recorded import RecordedFrames
from lidarcodec.commands.results.files import Converted
from lidarcodec.commands.running import remaining
from lidarcodec.commands.running.stopping import Watched, stoppable
from lidarcodec.commands.running.telling import tell
from lidarcodec.commands.sources import check_not_input
from lidarcodec.commands.unkept import positions_in, positions_text
from lidarcodec.errors import SourceError
from lidarcodec.files.whole import whole
from lidarcodec.sources.unit_calibration import warn_if_generic

log = logging.getLogger(__name__)


def run(recording: Path, out: Path, frames: int | None, skip: int, force: bool = False, as_json: bool = False) -> None:
    """Decode frame by frame. A cut or damaged recording gives all its complete frames."""
    check_not_input(out, recording)
    check_output(out, force=force)
    recorded = RecordedFrames(recording)
    count = points = positions = 0
    with (
        progress("decoding", frames) as tick,
        stoppable() as stopped,
        whole(out, force=force, contents=contents_of(out)) as output,
    ):
        watched = Watched(recorded, stopped)
        chosen = islice(watched, skip, None if frames is None else skip + frames)
        first = next(chosen, None)
        if first is None and stopped():
            raise remaining.stopped(out, None, 0)
        if first is None:
            _warn(recorded)
            raise SourceError(
                f"{recording} has no frame after the first {skip} that can be decoded: {out} was not written"
            )
        with _opened(out, output.beside) as writer:
            for frame in chain((first,), chosen):
                warn_if_generic(frame.sensor, str(recording))
                writer.write(frame)
                count, points = count + 1, points + frame.points
                positions += positions_in(frame)
                tick()
        if watched.cut:
            output.only_part()
    _warn(recorded)
    kept = output.kept or out
    found = Converted(
        output=str(kept), form=out.suffix.lower().lstrip(".") or "kitti",
        files=sum(1 for _ in kept.iterdir()) if kept.is_dir() else 1, beside=[], frames=count, packets=None,
        points=points, positions=positions, bytes=kept.stat().st_size if kept.is_file() else None,
    )  # fmt: skip
    tell(found, f"{kept}: {count} frames, {points:,} points{positions_text(out, positions)}", as_json)
    if watched.cut:
        raise remaining.stopped(out, output.kept, count, skip=skip, frames=frames)


@contextmanager
def _opened(out: Path, beside: Path) -> Iterator[Output]:
    """The open output. It is completed at the end; after an error its files are only closed."""
    writer = open_output(out, beside)
    try:
        yield writer
    except BaseException:
        with suppress(Exception):
            writer.close()
        raise
    writer.close()


def _warn(recorded: RecordedFrames) -> None:
    for text in recorded.warnings():
        log.warning("%s", text)

"""`lidarcodec decode`: a recording into packets, images or points."""

from __future__ import annotations

import logging
from itertools import islice
from pathlib import Path

from lidarcodec.commands.outputs import Opened, check_output, open_output
from lidarcodec.commands.progress import progress
from lidarcodec.commands.recorded import RecordedFrames
from lidarcodec.commands.sources import check_not_input
from lidarcodec.commands.stopping import stoppable
from lidarcodec.commands.unkept import positions_in, positions_text
from lidarcodec.errors import SourceError

log = logging.getLogger(__name__)


def run(recording: Path, out: Path, frames: int | None, skip: int) -> None:
    """Decode frame by frame; of a cut or damaged recording, all that is whole."""
    check_output(out)
    check_not_input(out, recording)
    recorded = RecordedFrames(recording)
    output: Opened | None = None
    count = points = positions = 0
    try:
        with progress("decoding", frames) as tick, stoppable() as stopped:
            for frame in islice(recorded, skip, None if frames is None else skip + frames):
                output = output or open_output(out)
                output.write(frame)
                count, points = count + 1, points + frame.points
                positions += positions_in(frame)
                tick()
                if stopped():
                    break
        if output is not None:
            output.close()
    except BaseException:
        if output is not None:
            output.leave()
        raise
    for text in recorded.warnings():
        log.warning("%s", text)
    if not count and stopped():
        return
    if not count:
        raise SourceError(
            f"{recording} has no frame behind the first {skip} that can be decoded: {out} was not written"
        )
    print(f"{out}: {count} frames, {points:,} points{positions_text(out, positions)}")

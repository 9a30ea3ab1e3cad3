"""write_frames: frames to a file of any format that commands write.

>>> from lidarcodec import read_frames
>>> from tempfile import TemporaryDirectory
>>> with TemporaryDirectory() as folder:
...     write_frames(read_frames("sim:city?frames=1"), Path(folder) / "town.ply") > 50_000
True
"""

from __future__ import annotations

import logging
from collections.abc import Iterable
from itertools import chain
from pathlib import Path
from typing import Final

from lidarcodec.cloud import Returns, second_returns, second_returns_text
from lidarcodec.commands.outputs.base import NO_CLOUD
from lidarcodec.commands.outputs.table import SCANS, check_output, check_returns, contents_of, form_of, opened
from lidarcodec.errors import SettingsError, SourceError
from lidarcodec.files.whole import whole
from lidarcodec.frame import Frame, several

logger = logging.getLogger(__name__)

EACH: Final = f"{SCANS}; for other files of one frame, write [frame] to each"


def write_frames(frames: Iterable[Frame], out: str | Path, *, returns: Returns = "first", force: bool = False) -> int:
    """Write frames as points or packets, in the format of the ending of `out`; returns the number of points.

    out: ends in .ply .pcd .las .laz .csv .e57 .npz (points), .mcap (clouds for viewers) or .pcap (packets); a folder
    gets a KITTI file for each frame. It appears when it is complete. force: replace it if it exists
    returns: the first return of each beam, or all; second returns that are left out are counted in a warning of
    `logging`
    Raises SettingsError for another ending, an output that exists or a format without a field for
    the number of a return, MissingExtraError if the format needs a library that is not installed, SourceError if there
    are no frames, OSError if the file cannot be written.
    """
    several(frames, "write_frames", "frames")
    path = Path(out)
    form = form_of(path, folder="kitti", each=EACH)
    if not force and (path.is_file() or (path.is_dir() and any(path.iterdir()))):
        raise SettingsError(f"{path} exists: choose another name, or pass force=True to replace it")
    check_output(path, form, force=force)
    check_returns(form, returns)
    rest = iter(frames)
    first = next(rest, None)
    if first is None:
        raise SourceError(f"there are no frames: {path} was not written")
    points = second = 0
    contents = contents_of(path, form)
    with (
        whole(path, force=force, contents=contents) as output,
        opened(path, form, output.beside, returns=returns) as writer,
    ):
        for frame in chain((first,), rest):
            cloud = frame.cloud(returns) if form.points else NO_CLOUD
            writer.write(frame, cloud)
            twice = second_returns(frame) if form.first_returns else 0
            points += len(cloud) if form.points else frame.points + twice * (returns == "all")
            second += twice * (returns == "first")
    if second:
        logger.warning("%s: %s", path, second_returns_text(second))
    return points

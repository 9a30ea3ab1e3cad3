"""`lidarcodec decode`: writes a recording as packets, images or points. The short form of `convert`."""

from __future__ import annotations

from pathlib import Path

from lidarcodec.commands.convert.frames import Wanted
from lidarcodec.commands.convert.frames import decode as write
from lidarcodec.commands.outputs.table import form_of
from lidarcodec.commands.selection.frames import Selection
from lidarcodec.commands.selection.points import Placing
from lidarcodec.sources.mounts import Mounted

FOLDER = "kitti"
"""Format of the files in a folder."""


def run(
    recording: Path,
    out: Path,
    form: str | None,
    selection: Selection,
    placing: Placing,
    poses: Path | None,
    mounted: Mounted,
    force: bool = False,
    as_json: bool = False,
) -> None:
    """Decode frame by frame. A cut or damaged recording gives all its complete frames."""
    wanted = Wanted(out, form_of(out, form, folder=FOLDER), selection, placing, force, as_json, chosen=form is not None)
    write(recording, wanted, poses, mounted)

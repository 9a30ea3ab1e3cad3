"""The job `map`: a map of a square of the ground, of all segments that saw it."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import numpy as np

from lidarcodec.archive.names import Commit
from lidarcodec.archive.objects import read_commit
from lidarcodec.archive.scratch import scratch_folder
from lidarcodec.archive.stores.base import Store
from lidarcodec.errors import SourceError
from lidarcodec.evaluation.rigid import Matrix
from lidarcodec.maps.build import MapBuilder
from lidarcodec.maps.drives import DriveSpec, by_given

STEP_UM: Final = 20_000
"""Step of coordinates, as the default of `map build`."""


def build_map(value: dict[str, Any], source: Store, target: Store) -> dict[str, Any]:
    """Build the map of a square. value: `name` of the map, `square` (column, line, side in m), `commits`

    A square with too few points for a map becomes `NAME.empty`. Raises SourceError, OSError.
    """
    col, line, side = value["square"]
    low = np.array([col, line], float) * side
    with scratch_folder() as folder:
        (tiles := folder / "tiles").mkdir()
        builder, drive = MapBuilder(tiles, STEP_UM), folder / "drive.mcap"
        for fields in value["commits"]:
            source.download(read_commit(source, Commit(*fields))["object"], drive)
            _add(builder, DriveSpec(str(drive)), low, side)
        points = _written(builder, folder / "square.lcmap")
        if points:
            target.create(f"{value['name']}.lcmap", folder / "square.lcmap")
        else:
            target.create(f"{value['name']}.empty", b"")
    return {"frames": builder.scans, "points": points}


def _add(builder: MapBuilder, drive: DriveSpec, low: Matrix, side: float) -> None:
    """Add the points of a drive within the square. A drive without poses has no place in it."""
    poses = drive.given_poses()
    if poses is None:
        return
    builder.start_drive()
    for points, pose in by_given(drive, poses):
        inside = ((points[:, :2] >= low) & (points[:, :2] < low + side)).all(axis=1)
        if inside.any():
            builder.add(points[inside], pose)


def _written(builder: MapBuilder, path: Path) -> int:
    """Number of points of the map; 0 if there are too few for one."""
    if not builder.scans:
        return 0
    with path.open("w+b") as file:
        try:
            return builder.write(file)
        except SourceError:  # too few points
            return 0

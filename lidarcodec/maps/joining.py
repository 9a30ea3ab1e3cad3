"""Several drives into one map: those whose poses are in one frame first, then the others where they overlap with it.

A drive may overlap only with one that is aligned itself, so all that are left are tried again when one was added.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from lidarcodec.errors import SourceError
from lidarcodec.evaluation.rigid import Matrix, moved
from lidarcodec.maps.align import Alignment, Sample, WeakOverlapError, aligned, samples_of
from lidarcodec.maps.build import MapBuilder
from lidarcodec.maps.drives import DriveSpec, PosedDrive, posed
from lidarcodec.maps.file import MapReader
from lidarcodec.maps.localise.window import MapWindow

MOST_IN_TILE: Final = 25_000
"""Of a tile with more points some are taken by lot, so that a block of the search has at most 3.6 million."""
Tick = Callable[[], None]


class Start(NamedTuple):
    """Where the first scan of a drive is in the map: metres, and degrees."""

    x: float
    y: float
    yaw_deg: float


@dataclass
class Joined:
    """A drive in a map. alignment: None if its poses were taken as they are"""

    drive: DriveSpec
    alignment: Alignment | None


class Joining:
    """Adds drives to a map. T_map_world: (4, 4) of the frame of the poses; folder: an empty one for files"""

    def __init__(self, builder: MapBuilder, T_map_world: Matrix, folder: Path, tick: Tick = lambda: None) -> None:
        self._builder, self._T_map_world, self._folder, self._tick = builder, T_map_world, folder, tick

    def add(self, drives: Sequence[DriveSpec], *, align: bool, starts: Sequence[Start | None]) -> list[Joined]:
        """Add drives, and say how each was added.

        align: whether poses of each drive are in a frame of its own; the frame of the map is that of the first one
        starts: of each drive, x and y in metres and yaw in degrees of its first scan in the map, if that is known

        Raises SourceError for a drive that does not overlap with the others, or does not fit them.
        """
        all_posed = [posed(drive, self._tick) for drive in drives]
        common = [one for one in all_posed if one.given][: 1 if align else None] or all_posed[:1]
        found = {id(one.drive): Joined(one.drive, None) for one in common}
        for one in common:
            self._put(one, self._T_map_world)
        waiting = [
            (one, samples_of(one.scans(), self._tick), start)
            for one, start in zip(all_posed, starts, strict=True)
            if id(one.drive) not in found
        ]
        while waiting:
            one, alignment = self._next(waiting)
            self._put(one, alignment.transform)
            found[id(one.drive)] = Joined(one.drive, alignment)
            waiting = [left for left in waiting if left[0] is not one]
        return [found[id(drive)] for drive in drives]

    def _put(self, one: PosedDrive, T_map_drive: Matrix) -> None:
        self._builder.start_drive()
        for points, pose in one.scans():
            self._builder.add(moved(T_map_drive, points), T_map_drive @ pose)
            self._tick()

    def _next(self, waiting: Sequence[tuple[PosedDrive, list[Sample], Start | None]]) -> tuple[PosedDrive, Alignment]:
        """The first drive that fits the map as it is now, and where. Raises SourceError if none does."""
        so_far = self._folder / "so-far.lcmap"
        with so_far.open("w+b") as file:
            self._builder.write(file, self._tick)
        with MapReader.open(so_far) as reader:
            path, refused = reader.path.astype(np.float64), None
            for one, samples, start in waiting:
                try:
                    return one, aligned(MapWindow(reader, MOST_IN_TILE), path, samples, start, self._tick)
                except WeakOverlapError as error:
                    refused = refused or SourceError(
                        f"{one.drive.spec} cannot be aligned with the drives before it: {error}; give --poses FILE "
                        "once for each drive, all in one frame, or --start"
                    )
        assert refused is not None
        raise refused

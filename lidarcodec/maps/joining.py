"""Several drives into one map: those whose poses are in one frame first, then the others where they overlap with it.

A drive may overlap only with one that is aligned itself, so all that are left are tried again when one was added.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from lidarcodec.errors import SourceError
from lidarcodec.evaluation.rigid import Matrix, moved
from lidarcodec.evaluation.trajectory import Trajectory
from lidarcodec.maps.align import Alignment, Sample, WeakOverlapError, aligned, samples_of
from lidarcodec.maps.build import MapBuilder
from lidarcodec.maps.drives import DriveSpec, PosedDrive, posed
from lidarcodec.maps.file import MapReader
from lidarcodec.maps.kept_build import KeptBuild
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


class Waiting(NamedTuple):
    """A drive that is still to be aligned: scans spread over its way, and where it begins in the map, if known."""

    one: PosedDrive
    samples: list[Sample]
    start: Start | None


class Joining:
    """Adds drives to a map. T_map_world: (4, 4) of the frame of the poses; folder: an empty one for files

    kept: what the builder has from before, and where what is done is noted
    tick: called after each scan; `kept` may be saved then
    """

    def __init__(
        self, builder: MapBuilder, T_map_world: Matrix, folder: Path, kept: KeptBuild, tick: Tick = lambda: None
    ) -> None:
        self._builder, self._T_map_world, self._folder, self._tick = builder, T_map_world, folder, tick
        self._kept = kept

    def add(self, drives: Sequence[DriveSpec], *, align: bool, starts: Sequence[Start | None]) -> list[Joined]:
        """Add drives, and say how each was added.

        align: whether poses of each drive are in a frame of its own; the frame of the map is that of the first one
        starts: of each drive, x and y in metres and yaw in degrees of its first scan in the map, if that is known

        Raises SourceError for a drive that does not overlap with the others, or does not fit them.
        """
        all_posed = [self._posed(number, drive) for number, drive in enumerate(drives)]
        given = [number for number, one in enumerate(all_posed) if one.given]
        found: dict[int, Alignment | None] = {}
        for begun in list(self._kept.begun(len(drives))):
            found[begun.number] = begun.aligned()
            self._put(begun.number, all_posed[begun.number], found[begun.number])
        for number in given[: 1 if align else None] or [0]:
            if number not in found:
                found[number] = None
                self._put(number, all_posed[number], None)
        waiting = {
            number: Waiting(one, samples_of(one.scans(), self._tick), starts[number])
            for number, one in enumerate(all_posed)
            if number not in found
        }
        while waiting:
            number, found[number] = self._next(waiting)
            self._put(number, waiting.pop(number).one, found[number])
        return [Joined(drive, found[number]) for number, drive in enumerate(drives)]

    def _posed(self, number: int, drive: DriveSpec) -> PosedDrive:
        """A drive with its poses; those that were found are kept."""
        known = self._kept.trajectory(number)
        if known is not None:
            return PosedDrive(drive, known, given=False)
        one = posed(drive, self._tick)
        if isinstance(one.poses, Trajectory):
            self._kept.keep_trajectory(number, one.poses)
        return one

    def _put(self, number: int, one: PosedDrive, alignment: Alignment | None) -> None:
        """Add what is not yet in the map of a drive."""
        T_map_drive = self._T_map_world if alignment is None else alignment.transform
        begun = self._kept.begin(number, alignment)
        if begun.whole:
            return
        if not begun.scans:
            self._builder.start_drive()
        for points, pose in islice(one.scans(), begun.scans, None):
            self._builder.add(moved(T_map_drive, points), T_map_drive @ pose)
            begun.scans += 1
            self._tick()
        begun.whole = True

    def _next(self, waiting: Mapping[int, Waiting]) -> tuple[int, Alignment]:
        """The number of the first drive that fits the map as it is now, and where. Raises SourceError if none does."""
        so_far = self._folder / "so-far.lcmap"
        with so_far.open("w+b") as file:
            self._builder.write(file, self._tick)
        with MapReader.open(so_far) as reader:
            path, refused = reader.path.astype(np.float64), None
            for number, (one, samples, start) in waiting.items():
                try:
                    return number, aligned(MapWindow(reader, MOST_IN_TILE), path, samples, start, self._tick)
                except WeakOverlapError as error:
                    refused = refused or SourceError(
                        f"{one.drive.spec} cannot be aligned with the drives before it: {error}; give --poses FILE "
                        "once for each drive, all in one frame, or --start"
                    )
        assert refused is not None
        raise refused

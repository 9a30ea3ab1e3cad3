"""Drives for a map: their scans, deskewed and moved into the world, one after the other.

Poses are given (a file, the simulator's own, or those in a recording), or found: odometry by small_gicp, then every
scan is registered in a map of all. To find them, a source is read several times; its scans are never all in memory.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any, Final, NamedTuple, overload

import numpy as np

from lidarcodec.errors import SourceError
from lidarcodec.evaluation.rigid import Matrix, moved
from lidarcodec.evaluation.trajectory import Scan, Trajectory, deskewed, near, odometry, refine, scan_of
from lidarcodec.frame import Frame
from lidarcodec.pipeline import frames_of
from lidarcodec.sources import PacketSource, open_source
from lidarcodec.sources.mounts import NOT_SAID, Mounted
from lidarcodec.sources.posed import with_poses
from lidarcodec.sources.poses import Poses
from lidarcodec.sources.recording import RecordingSource

WHOLE: Final = 0.95
"""A frame with at least this share of the usual width is a whole turn; others are left out."""
FIRST_FRAMES: Final = 6
"""Frames that say how wide a turn usually is."""
MOST_FOUND: Final = 3000
"""Scans whose poses are found: the map in which they are registered is in memory."""
Tick = Callable[[], None]


class Seen(NamedTuple):
    """A scan in the world: points (N, 3), and the sensor's pose (4, 4) at its stamp."""

    points: Matrix
    pose: Matrix


@dataclass(frozen=True)
class DriveSpec:
    """spec: the source; poses: a file of them; frames, skip: as of all commands; every: 1 of how many scans is used

    mounted: where the sensor sits, and whose poses the file has;  unkept: what the source counted while it was read
    """

    spec: str
    poses: Path | None = None
    calibration: Path | None = None
    frames: int | None = None
    skip: int = 0
    every: int = 1
    mounted: Mounted = NOT_SAID
    unkept: Counter[str] = field(default_factory=Counter, compare=False)

    def opened(self) -> PacketSource:
        """The source, with its poses and its mounting."""
        source = open_source(self.spec, calibration=self.calibration, poses=self.poses)
        self.mounted.given_to(source)
        return source

    def scans(self) -> Iterator[Scan]:
        """The whole turns of the source, as they were received. Raises SourceError, PacketError, CalibrationError."""
        with self.opened() as source:
            end = None if self.frames is None else self.skip + self.frames
            frames = islice(frames_of(source.packets(), source.sensor, "revolution"), self.skip, end)
            first = list(islice(frames, FIRST_FRAMES))
            usual = float(np.median([frame.width for frame in first])) if first else 0.0
            try:
                for number, frame in enumerate(_whole((*first,), frames, usual)):
                    if number % self.every == 0:
                        yield scan_of(frame)
            finally:
                self.unkept.update(source.counts - self.unkept)  # it is read more than once

    def given_poses(self) -> Poses | None:
        """Poses of a file, of the simulator, or of the messages of a recording or a bag; None if there are none."""
        with self.opened() as source:
            if source.poses is not None:
                # those of a file without times begin with the first packet
                return source.poses if source.start_ns is None else source.poses.starting(source.start_ns)
            if source.carried is None:
                return None
            if isinstance(source, RecordingSource):
                frames = source.frames()
            else:
                frames = with_poses(frames_of(source.packets(), source.sensor, "revolution"), source.carried)
            known = [(frame.stamp_ns, frame.pose) for frame in frames if frame.pose is not None]
        if len(known) < 2:
            return None
        return Poses(np.array([stamp for stamp, _ in known], np.int64), np.stack([pose for _, pose in known]))


def _whole(first: Sequence[Frame], rest: Iterator[Frame], usual: float) -> Iterator[Frame]:
    for frames in (first, rest):
        yield from (frame for frame in frames if frame.width >= WHOLE * usual)


@dataclass(frozen=True)
class PosedDrive:
    """A drive whose poses are known. given: whether they were; otherwise they were found, from its own scans"""

    drive: DriveSpec
    poses: Poses | Trajectory
    given: bool

    def scans(self) -> Iterator[Seen]:
        """The scans in the frame of the poses. Of poses that were found the first scan is the origin, or the vehicle at
        that scan where the mounting of the sensor is known. Raises SourceError if the poses do not cover a scan.
        """
        if isinstance(self.poses, Poses):
            return by_given(self.drive, self.poses)
        return _by_found(self.drive, self.poses)


def posed(drive: DriveSpec, tick: Tick = lambda: None) -> PosedDrive:
    """A drive with its poses. If there are none they are found, about 1 s a scan. Raises SourceError."""
    given = drive.given_poses()
    if given is not None:
        return PosedDrive(drive, given, given=True)
    return PosedDrive(drive, found_trajectory(drive, tick), given=False)


def by_given(drive: DriveSpec, poses: Poses) -> Iterator[Seen]:
    """The scans of a drive in the world, by poses that are known. Raises SourceError if they do not cover a scan."""
    for scan in drive.scans():
        yield _seen(scan, Trajectory.from_poses(poses, [scan.stamp_ns]), 0)


def _by_found(drive: DriveSpec, found: Trajectory) -> Iterator[Seen]:
    with drive.opened() as source:
        T_world_first = None if source.mount is None else source.mount.T_vehicle_sensor
    for number, scan in enumerate(drive.scans()):
        seen = _seen(scan, found, number)
        yield seen if T_world_first is None else Seen(moved(T_world_first, seen.points), T_world_first @ seen.pose)


def _seen(scan: Scan, found: Trajectory, at: int) -> Seen:
    pose = found.matrices[at]
    return Seen(moved(pose, near(deskewed(scan, found.velocities[at]))), pose)


def found_trajectory(drive: DriveSpec, tick: Tick = lambda: None) -> Trajectory:
    """Poses of a drive's scans by odometry and registration in a map of all of them, about 1 s a scan.

    Raises SourceError for a drive of fewer than 2 or more than 3,000 scans.
    """
    stamps: list[int] = []

    def counted() -> Iterator[Scan]:
        for scan in drive.scans():
            if len(stamps) == MOST_FOUND:
                raise SourceError(
                    f"{drive.spec} has more than {MOST_FOUND} scans: give --poses FILE, or build a map of --frames N"
                )
            stamps.append(scan.stamp_ns)
            yield scan

    start = odometry(counted(), tick=tick)
    if len(stamps) < 2:
        raise SourceError(f"{drive.spec} has {len(stamps)} whole turns, which is too few for a map")
    return refine(_Again(drive, len(stamps)), start, 1, tick)


@dataclass
class _Again(Sequence[Scan]):
    """The scans of a drive, read again when an earlier one is asked for."""

    drive: DriveSpec
    size: int
    _next: int = 0
    _scans: Iterator[Scan] = field(default_factory=lambda: iter(()))

    def __len__(self) -> int:
        return self.size

    @overload
    def __getitem__(self, at: int) -> Scan: ...

    @overload
    def __getitem__(self, at: slice) -> Sequence[Scan]: ...

    def __getitem__(self, at: Any) -> Any:
        if at < self._next or not self._next:
            self._scans, self._next = self.drive.scans(), 0
        for scan in self._scans:
            self._next += 1
            if self._next == at + 1:
                return scan
        raise SourceError(f"{self.drive.spec} has fewer scans than when it was read before")

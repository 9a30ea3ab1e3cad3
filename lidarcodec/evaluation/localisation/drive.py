"""A drive in memory: its complete turns, their times, and the points of a frame as seen from its stamp.

>>> drive = read_drive("sim:street?frames=4")
>>> len(drive.frames), drive.name
(4, 'sim:street?frames=4')
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from lidarcodec.errors import SourceError
from lidarcodec.evaluation.rigid import Matrix
from lidarcodec.evaluation.trajectory import FARTHEST_M, NEAREST_M, Scan, deskewed, scan_of
from lidarcodec.frame import Frame
from lidarcodec.pipeline import frames_of
from lidarcodec.sources import open_source
from lidarcodec.sources.poses import Poses
from lidarcodec.sources.unkept import say_unkept

WHOLE: Final = 0.95
"""A frame with at least this share of the usual width counts as a complete turn. A drive begins and ends with
incomplete turns."""
FEWEST_FRAMES: Final = 2


@dataclass(frozen=True)
class Drive:
    """name: name of the source; frames: complete frames, in order; stamps_ns: (F,) int64, host time of the middle of
    each frame; poses: poses of the source, if it has any; exact: whether the packets were simulated with these
    poses"""

    name: str
    frames: list[Frame]
    stamps_ns: npt.NDArray[np.int64] = field(repr=False)
    poses: Poses | None = None
    exact: bool = False

    def scan(self, at: int, frame: Frame | None = None) -> Scan:
        """The returns of frame number `at`, or of its decoded frame, with times relative to the original's stamp."""
        found = scan_of(self.frames[at] if frame is None else frame)
        stamp = int(self.stamps_ns[at])
        later = np.float32((found.stamp_ns - stamp) * 1e-9)
        return Scan(stamp, found.points, found.after_s + later)

    def cloud(self, at: int, velocity: Matrix, frame: Frame | None = None) -> Matrix:
        """(N, 3) the points of `scan`, as seen from the sensor's pose at the stamp. Points nearer than 3 m (the car
        itself) and beyond 80 m are omitted. velocity: (6,) velocity of the sensor during the turn"""
        scan = self.scan(at, frame)
        return deskewed(scan, velocity)[in_reach(scan.points)]


def in_reach(points: npt.NDArray[np.floating]) -> npt.NDArray[np.bool_]:
    """(N,) whether points (N, 3) are neither on the car itself nor too far away."""
    distance = np.linalg.norm(points, axis=1)
    reached: npt.NDArray[np.bool_] = (distance > NEAREST_M) & (distance < FARTHEST_M)
    return reached


def read_drive(
    spec: str | Path,
    *,
    framing: str = "revolution",
    frames: int | None = None,
    skip: int = 0,
    calibration: Path | None = None,
    poses: Path | None = None,
    tick: Callable[[], None] = lambda: None,
) -> Drive:
    """Read the drive of a source. It needs 0.5 MB of memory for each frame.

    frames: most frames, including incomplete turns; skip: number of frames to skip first
    Raises SourceError, also if there are fewer than two complete frames, SettingsError, CalibrationError.
    """
    found = []
    with open_source(spec, calibration=calibration, poses=poses) as source:
        source.sensor.no_cloud("evaluate localisation")
        end = None if frames is None else skip + frames
        for frame in islice(frames_of(source.packets(), source.sensor, framing), skip, end):
            found.append(frame)
            tick()
        say_unkept(str(spec), source.counts)
        given, exact = source.poses, poses is None and str(spec).startswith("sim:")
    usual = np.median([frame.width for frame in found]) if found else 0
    whole = [frame for frame in found if frame.width >= WHOLE * usual]
    if len(whole) < FEWEST_FRAMES:
        raise SourceError(f"{spec} has {len(whole)} complete frames, which is too few for localisation")
    stamps = np.array([scan_of(frame).stamp_ns for frame in whole], np.int64)
    return Drive(str(spec), whole, stamps, given, exact)

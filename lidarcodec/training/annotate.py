"""Annotation of a drive: counts from how many poses the place of each return was seen, and labels the return.

    frames      read once, in order
    trajectory  given, or by odometry and refinement
    map         voxel means of every fifth scan
    counts      for each point of the map the poses that have a return within 0.1 m, each pose once
    labels      each return takes the count of the nearest point of the map; ground; Algorithm 1

Each stage writes files (`AnnotationFolder`), and is skipped if its files exist. Counting and labelling work on pieces
of
25 frames, in one process or in several; the result does not depend on their number.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import lru_cache
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from lidarcodec import _native
from lidarcodec.errors import SettingsError, SourceError
from lidarcodec.evaluation.rigid import invert, moved
from lidarcodec.evaluation.trajectory import (
    CellMeans,
    Trajectory,
    deskewed,
    near,
    odometer_of,
    odometry,
    refine,
    voxel_means,
)
from lidarcodec.frame import Frame
from lidarcodec.sources.poses import Poses
from lidarcodec.training.annotation_folder import AnnotationFolder, Labels, Scans
from lidarcodec.training.ground import ground_finder
from lidarcodec.training.labels import NAMES, SHARE, labels_of, threshold_of
from lidarcodec.units import AZIMUTH_TURN, FRAME_COLUMNS
from lidarcodec.untrusted.children import safe_path
from lidarcodec.untrusted.npz import read_npy

WARM_UP: Final = 5
"""Number of earlier frames that a ground detector with state sees before a piece."""
INDEX_CELL_M, ASSIGN_M, REACH_M = 0.2, 0.5, 80.0

Tick = Callable[[], None]


@dataclass(frozen=True)
class AnnotationSettings:
    """How a drive is annotated.

    source:     name of the source, for the record;  made_of: digest of the source, its calibration and its poses
    odometry: see `trajectory.odometry`; only without poses
    refine:     whether poses are refined against the map (odometry always is)
    every:      the map uses every so many scans;  cell_m: its voxels;  d_th_m: a place is seen if a return is this near
    travel_m:   a pose counts only after so much travel since the last counted pose, so a standing car adds no counts
    label_every: every so many scans are labelled
    share:      share of all returns above the threshold of Algorithm 1;  ground: see `ground.METHODS`
    piece:      frames in a piece of work; a ground detector with state starts again for each piece
    """

    source: str = ""
    made_of: str = ""
    odometry: str = "auto"
    refine: bool = False
    every: int = 5
    cell_m: float = 0.1
    d_th_m: float = 0.1
    travel_m: float = 0.5
    label_every: int = 1
    share: float = SHARE
    ground: str = "ransac"
    piece: int = 25

    def __post_init__(self) -> None:
        bounds = {
            "every": (1, 1000),
            "label_every": (1, 1000),
            "piece": (1, 1000),
            "cell_m": (0.02, 2.0),
            "d_th_m": (0.01, 1.0),
            "travel_m": (0.0, 100.0),
        }
        for name, (least, most) in {**bounds, "share": (0.0, 1.0)}.items():
            if not least <= getattr(self, name) <= most:
                raise SettingsError(f"{name} must be {least:g} to {most:g}, not {getattr(self, name):g}", name)


def annotate(
    frames: Iterable[Frame],
    folder: AnnotationFolder,
    settings: AnnotationSettings,
    poses: Poses | None = None,
    workers: int = 1,
    stage: Callable[[str, int], Any] | None = None,
) -> dict[str, Any]:
    """Annotate a drive, or continue a stopped run. Returns the contents of annotation.json at the end.

    frames:  frames of the drive; incomplete turns at the end are skipped
    workers: processes for counts and labels;  stage(name, steps): a context with a function to call after each step
    Raises SettingsError, UnknownNameError, MissingExtraError; SourceError if there are no frames or poses do not fit.
    """
    if workers < 1:
        raise SettingsError(f"{workers} workers: at least 1 is needed", "workers")
    ground_finder(settings.ground)  # a missing package must be reported before an hour of work
    if poses is None:  # also before the folder is begun, because it would store a wrong name
        odometer_of(settings.odometry)()
    begun = _Stages(stage)
    with begun("frames", 0) as tick:
        _read(frames, folder, settings, tick)
    count = folder.frames
    if not folder.has("trajectory.npz"):
        with begun("trajectory", count * (1 if poses is not None and not settings.refine else 2)) as tick:
            folder.write_trajectory(_trajectory(folder, settings, poses, tick))
    if not folder.has("points.npz"):
        with begun("map", len(range(0, count, settings.every))) as tick:
            folder.write_map(_map(folder, settings, tick), None)
    if not folder.has("map.npz"):
        left = [first for first in range(0, count, settings.piece) if not folder.has(f"seen-{first:06d}.npy")]
        with begun("counts", len(left)) as tick:
            _spread(_count_chunk, folder, settings, left, workers, tick)
        folder.write_map(folder.map_points(), _sum_of_parts(folder, settings.piece))
    left = [first for first in range(0, count, settings.piece) if not _is_labelled(folder, settings, first)]
    with begun("labels", len(left)) as tick:
        _spread(_label_chunk, folder, settings, left, workers, tick)
    for part in folder.parts(settings.piece):
        part.unlink(missing_ok=True)
    folder.note(**_summary(folder), seconds=(folder.about() or {}).get("seconds", {}) | begun.seconds, done=True)
    return folder.about() or {}


class _Stages:
    """Times each stage, and reports it."""

    def __init__(self, stage: Callable[[str, int], Any] | None) -> None:
        self._stage = stage
        self.seconds: dict[str, float] = {}

    @contextmanager
    def __call__(self, name: str, steps: int) -> Iterator[Tick]:
        began = time.monotonic()
        if self._stage is None:
            yield lambda: None
        else:
            with self._stage(name, steps) as tick:
                yield tick
        self.seconds[name] = round(time.monotonic() - began, 2)


def _read(frames: Iterable[Frame], folder: AnnotationFolder, settings: AnnotationSettings, tick: Tick) -> None:
    """Write frames to files, unless they exist. The sensor of the first frame is the sensor of the folder."""
    about = folder.about()
    if about is not None and "frames" in about:
        folder.begin(asdict(settings), folder.sensor)
        return
    count = 0
    for frame in frames:
        if not _is_most_of_a_turn(frame):
            continue
        if count == 0:
            folder.begin(asdict(settings), frame.sensor)
        folder.write_frame(count, frame)
        count += 1
        tick()
    if not count:
        raise SourceError(f"{settings.source} has no complete frame to annotate")
    folder.note(frames=count)


def _is_most_of_a_turn(frame: Frame) -> bool:
    if frame.sensor.is_hdl64e:
        return frame.width >= FRAME_COLUMNS // 2
    return int((np.diff(frame.azimuth[0].astype(np.int64)) % AZIMUTH_TURN).sum()) > AZIMUTH_TURN // 2


def _trajectory(folder: AnnotationFolder, settings: AnnotationSettings, poses: Poses | None, tick: Tick) -> Trajectory:
    scans = Scans(folder)
    if poses is None:
        return refine(scans, odometry(scans, settings.odometry, tick), tick=tick)
    stamps = []
    for scan in scans:
        stamps.append(scan.stamp_ns)
        tick()
    given = Trajectory.from_poses(poses, stamps)
    return refine(scans, given, tick=tick) if settings.refine else given


def _map(folder: AnnotationFolder, settings: AnnotationSettings, tick: Tick) -> npt.NDArray[np.float32]:
    scans, trajectory = Scans(folder), folder.trajectory()
    cells = CellMeans(settings.cell_m)
    for k in range(0, len(scans), settings.every):
        seen = moved(trajectory.matrices[k], near(deskewed(scans[k], trajectory.velocities[k])))
        cells.add(voxel_means(seen, settings.cell_m))
        tick()
    return cells.means().astype(np.float32)


@dataclass(frozen=True)
class _Drive:
    """Data of a drive that a process reads once."""

    folder: AnnotationFolder
    scans: Scans
    trajectory: Trajectory
    index: Any

    def in_world(self, k: int) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """(N, 3) the deskewed returns of a scan, and the same in the world."""
        own = deskewed(self.scans[k], self.trajectory.velocities[k])
        return own, np.ascontiguousarray(moved(self.trajectory.matrices[k], own))


@lru_cache(maxsize=1)
def _drive(path: Path) -> _Drive:
    folder = AnnotationFolder(path)
    index = _native.VoxelIndex(folder.map_points().astype(np.float64), INDEX_CELL_M)
    return _Drive(folder, Scans(folder), folder.trajectory(), index)


def _piece(settings: AnnotationSettings, first: int, count: int) -> range:
    return range(first, min(first + settings.piece, count))


def _labelled(settings: AnnotationSettings, first: int, count: int) -> list[int]:
    """The frames of a piece to label."""
    return [k for k in _piece(settings, first, count) if k % settings.label_every == 0]


def _is_labelled(folder: AnnotationFolder, settings: AnnotationSettings, first: int) -> bool:
    return all(folder.has(f"labels/{k:06d}.npz") for k in _labelled(settings, first, folder.frames))


def counted_poses(matrices: npt.NDArray[np.float64], travel_m: float) -> npt.NDArray[np.bool_]:
    """(F,) bool, the counted poses: each at least `travel_m` from the previous counted one."""
    counted = np.zeros(len(matrices), np.bool_)
    last: npt.NDArray[np.float64] | None = None
    for k, place in enumerate(matrices[:, :3, 3]):
        if last is None or np.linalg.norm(place - last) >= travel_m:
            counted[k], last = True, place
    return counted


def _count_chunk(path: Path, settings: AnnotationSettings, first: int) -> None:
    drive = _drive(path)
    counted = counted_poses(drive.trajectory.matrices, settings.travel_m)
    seen = np.zeros(len(drive.index), np.uint16)
    for k in _piece(settings, first, len(drive.scans)):
        if counted[k]:
            own, world = drive.in_world(k)
            within = np.einsum("ij,ij->i", own, own) < REACH_M**2
            seen += drive.index.near(np.ascontiguousarray(world[within]), settings.d_th_m)
    drive.folder.write_part(first, seen)


def _sum_of_parts(folder: AnnotationFolder, piece: int) -> npt.NDArray[np.uint16]:
    total: npt.NDArray[Any] = np.zeros(len(folder.map_points()), np.int64)
    for part in folder.parts(piece):
        try:
            total += read_npy(part)
        except (OSError, ValueError) as error:
            raise SourceError(f"cannot read {part}: {error}") from None
    most: npt.NDArray[np.uint16] = np.minimum(total, 65535).astype(np.uint16)
    return most


def _label_chunk(path: Path, settings: AnnotationSettings, first: int) -> None:
    drive = _drive(path)
    of_map = np.append(drive.folder.map_counts(), np.uint16(0))  # the last count: no point is near
    finder = ground_finder(settings.ground)
    if settings.ground == "patchwork":
        for k in range(max(first - WARM_UP, 0), first):
            finder.ground(drive.in_world(k)[0])
    for k in _labelled(settings, first, len(drive.scans)):
        own, world = drive.in_world(k)
        counts = of_map[drive.index.nearest(world, ASSIGN_M)]
        ground = finder.ground(own)
        labels = labels_of(counts, ground, settings.share)
        valid = drive.folder.frame(k, drive.folder.sensor).valid
        images = [np.zeros(valid.T.shape, dtype) for dtype in (np.uint16, np.uint8)]
        images[0][valid.T], images[1][valid.T] = counts, labels
        least = threshold_of(counts[~ground], len(counts), settings.share)
        drive.folder.write_labels(k, Labels(images[0].T.copy(), images[1].T.copy(), least))


def _spread(
    work: Callable[[Path, AnnotationSettings, int], None],
    folder: AnnotationFolder,
    settings: AnnotationSettings,
    firsts: list[int],
    workers: int,
    tick: Tick,
) -> None:
    """Process each piece here, or in `workers` processes. The first error ends it and is raised."""
    path = folder.path.resolve()
    if min(workers, len(firsts)) <= 1:
        _drive.cache_clear()
        for first in firsts:
            work(path, settings, first)
            tick()
        _drive.cache_clear()
        return
    spawn = get_context("spawn")
    with safe_path(), ProcessPoolExecutor(min(workers, len(firsts)), mp_context=spawn) as pool:
        pieces: list[Future[None]] = [pool.submit(work, path, settings, first) for first in firsts]
        try:
            for piece in as_completed(pieces):
                piece.result()
                tick()
        except BaseException:
            pool.shutdown(wait=True, cancel_futures=True)
            raise


def _summary(folder: AnnotationFolder) -> dict[str, Any]:
    """Shares of the labels, counts of returns that are not ground, and the length of the drive."""
    shares, medians, least = np.zeros(len(NAMES)), [], []
    labelled_frames = folder.labelled()
    for k in labelled_frames[:: max(len(labelled_frames) // 50, 1)]:
        found = folder.labels(k)
        shares += np.bincount(found.labels.ravel(), minlength=len(NAMES))
        rest = found.counts[(found.labels > 0) & (found.labels < 3)]
        medians.append(float(np.median(rest)) if len(rest) else 0.0)
        least.append(found.threshold)
    steps = (invert(folder.trajectory().matrices[:-1]) @ folder.trajectory().matrices[1:])[:, :3, 3]
    labelled = shares[1:] / max(shares[1:].sum(), 1.0)
    return {
        "map_points": len(folder.map_points()),
        "travelled_m": round(float(np.linalg.norm(steps, axis=1).sum()), 2),
        "shares": {name: round(float(share), 4) for name, share in zip(NAMES[1:], labelled, strict=True)},
        "median_count": float(np.median(medians)),
        "median_threshold": float(np.median(least)),
    }

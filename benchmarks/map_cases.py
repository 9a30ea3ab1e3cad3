"""Drives for `benchmarks.maps`: their poses, their scans that are looked for and their whole maps, kept in a folder."""

from __future__ import annotations

import io
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from benchmarks.scenes import DATA
from lidarcodec.evaluation.localisation.drive import read_drive
from lidarcodec.evaluation.localisation.protocol import Scored, scored_frames
from lidarcodec.evaluation.localisation.reference import find_reference
from lidarcodec.evaluation.rigid import Matrix, moved
from lidarcodec.evaluation.trajectory import Trajectory
from lidarcodec.maps.build import MapBuilder
from lidarcodec.maps.file import MapReader
from lidarcodec.maps.localise.accuracy import SCANS, Scans, seen
from lidarcodec.maps.points import MapPoints

SIMULATED: Final = ("road", "road-2", "road-3", "motorway", "bend", "city", "city-2")
DRIVES: Final = {
    "road": "sim:road?frames=150",
    "road-2": "sim:road?seed=2&frames=150",
    "road-3": "sim:road?seed=3&frames=150",
    "motorway": "sim:motorway?frames=150",
    "bend": "sim:bend?frames=150",
    "city": "sim:city?frames=150",
    "0013": str(DATA / "kitti_0013_f052-107.pcap.xz"),
    "0005": str(DATA / "kitti_0005.pcap.xz"),
    "0001": str(DATA / "kitti_0001_f000-089.pcap.xz"),
}
OTHERS: Final = {"city-2": "sim:city?seed=2&frames=150"}
"""Drives that scans are not looked for in."""
CALIBRATION: Final = DATA / "kitti_hdl64e_s2_recovered_db.xml"
STRIDE: Final = 3
STEP_UM: Final = 20_000
LEAST_SEEN: Final = 2
SEED: Final = 1
GRID_M: Final = 0.001
"""In which the returns that are looked for are kept."""


@dataclass(frozen=True)
class Case:
    """A drive: its poses, its scans that are looked for, and its whole map."""

    name: str
    poses: Trajectory
    scored: Scored
    whole: MapPoints
    clouds: dict[Scans, dict[int, Matrix]]


def case_of(name: str, cache: Path) -> Case:
    """A drive. What takes long to make is kept in the folder `cache`: `NAME-traj.npz` and `NAME-case.npz`."""
    kept = cache / f"{name}-case.npz"
    if not kept.exists():
        _make(name, cache, kept)
    poses = Trajectory.load(cache / f"{name}-traj.npz")
    scored = scored_frames(len(poses), STRIDE)
    with np.load(kept) as arrays:
        whole = MapReader(io.BytesIO(arrays["map"].tobytes())).points()
        clouds = {
            scans: {at: arrays[f"{number}-{at}"] * GRID_M for at in scored.tracked.tolist()}
            for number, scans in enumerate(SCANS)
        }
    return Case(name, poses, scored, whole, clouds)


def _make(name: str, cache: Path, kept: Path) -> None:
    """Read the drive, build its map of the scans that are not looked for, and keep all."""
    drive = read_drive((DRIVES | OTHERS)[name], calibration=None if name in SIMULATED else CALIBRATION)
    known = cache / f"{name}-traj.npz"
    if not known.exists():
        cache.mkdir(parents=True, exist_ok=True)
        find_reference(drive).trajectory.save(known)
    poses = Trajectory.load(known)
    looked_for = set(scored_frames(len(drive.frames), STRIDE).tracked.tolist())
    arrays = {}
    with tempfile.TemporaryDirectory() as folder:
        builder = MapBuilder(Path(folder), STEP_UM, least_seen=LEAST_SEEN)
        for at in range(len(drive.frames)):
            cloud = drive.cloud(at, poses.velocities[at])
            if at not in looked_for:
                builder.add(moved(poses.matrices[at], cloud), poses.matrices[at])
                continue
            for number, scans in enumerate(SCANS):
                arrays[f"{number}-{at}"] = np.rint(seen(scans, cloud, SEED + at) / GRID_M).astype(np.int32)
        file = io.BytesIO()
        builder.write(file)
    np.savez_compressed(kept, map=np.frombuffer(file.getvalue(), np.uint8), **arrays)

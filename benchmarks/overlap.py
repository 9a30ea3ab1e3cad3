"""How exactly drives are put into one map by their overlap, and whether those without any are refused.

    python -m benchmarks.overlap --cache DIR [--cases "NAME;NAME"] [--save]

Poses of both drives are known, but those of the second are turned and moved, so the right alignment is known as well.
The error is the largest one along the way of both drives. KITTI's poses are refined from all of its scans
(`benchmarks.maps` keeps them in DIR). Of its halves one has even scans and the other odd ones, so they share none.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from benchmarks import results
from benchmarks.map_cases import CALIBRATION, DRIVES
from lidarcodec.errors import SourceError
from lidarcodec.evaluation.localisation.drive import read_drive
from lidarcodec.evaluation.localisation.reference import find_reference
from lidarcodec.evaluation.rigid import Matrix, exp_so3, log_so3, moved
from lidarcodec.evaluation.trajectory import Trajectory
from lidarcodec.maps.align import Alignment
from lidarcodec.maps.build import MapBuilder
from lidarcodec.maps.drives import DriveSpec
from lidarcodec.maps.joining import Joining
from lidarcodec.maps.kept_build import KeptBuild
from lidarcodec.sources.poses import Poses

STEP_UM: Final = 20_000
LEAST_SEEN: Final = 2
EVERY_NS: Final = 20_000_000
COLUMNS: Final = ["drives", "scans that fit", "of its way overlaps", "they agree to", "error", "refused because"]
TURNED: Final = np.eye(4)
TURNED[:3, :3], TURNED[:3, 3] = exp_so3(np.array([0.0, 0.0, np.radians(77.0)])), (35.0, -20.0, 1.5)
"""T_own_world of the second drive."""


class Case(NamedTuple):
    """Two drives. poses: of both of them, where they are not the simulator's"""

    first: DriveSpec
    second: DriveSpec
    poses: Callable[[Path], Poses] | None = None


def _refined(cache: Path) -> Poses:
    """Poses of KITTI 0005, kept in a folder."""
    known = cache / "0005-traj.npz"
    if not known.exists():
        cache.mkdir(parents=True, exist_ok=True)
        find_reference(read_drive(DRIVES["0005"], calibration=CALIBRATION)).trajectory.save(known)
    return Trajectory.load(known).poses()


def _city(seed: int, skip: int) -> DriveSpec:
    return DriveSpec(f"sim:city?seed={seed}&traffic=0&skip={skip}", frames=30)


def _half(skip: int, frames: int) -> DriveSpec:
    return DriveSpec(DRIVES["0005"], None, CALIBRATION, frames, skip, every=2)


CASES: Final = {
    "city, one street in both directions": Case(_city(3, 400), _city(3, 1080)),
    "city, two streets": Case(_city(3, 400), _city(3, 2000)),
    "two cities": Case(_city(3, 400), _city(5, 400)),
    "KITTI 0005, frames 0 to 90 and 61 to 153": Case(_half(0, 91), _half(61, 93), _refined),
}


def _with_poses(drive: DriveSpec, transform: Matrix, poses: Poses | None, path: Path) -> DriveSpec:
    """A drive with a file of its poses in another frame."""
    if poses is None:
        with drive.opened() as source:
            known = source.poses
            start_ns = next(iter(source.packets())).stamp_ns
        stamps = start_ns + np.arange((drive.frames or 0) * 100_000_000 // EVERY_NS + 20) * EVERY_NS
    else:
        known, stamps = poses, poses.stamps_ns
    assert known is not None
    found = [pose for stamp in stamps.tolist() if (pose := known.at(stamp)) is not None]
    np.savez(path, T_world_sensor=transform @ np.stack(found), stamps=stamps[: len(found)] * 1e-9)
    return DriveSpec(drive.spec, path, drive.calibration, drive.frames, drive.skip, drive.every)


def aligned(case: Case, cache: Path, folder: Path) -> tuple[Alignment, list[Matrix]]:
    """How a case was aligned, and the places of the sensors. Raises SourceError where it is refused."""
    poses = None if case.poses is None else case.poses(cache)
    drives = [
        _with_poses(drive, transform, poses, folder / f"{number}.npz")
        for number, (drive, transform) in enumerate(((case.first, np.eye(4)), (case.second, TURNED)))
    ]
    (tiles := folder / "tiles").mkdir()
    builder = MapBuilder(tiles, STEP_UM, least_seen=LEAST_SEEN)
    joining = Joining(builder, np.eye(4), folder, KeptBuild(tiles, {}))
    alignment = joining.add(drives, align=True, starts=[None, None])[1].alignment
    assert alignment is not None
    return alignment, builder.path


def row_of(name: str, case: Case, cache: Path) -> list[str]:
    """A row of the table."""
    with tempfile.TemporaryDirectory() as folder:
        try:
            found, path = aligned(case, cache, Path(folder))
        except SourceError as error:
            return [name, "-", "-", "-", "-", str(error).partition(": ")[2].partition(";")[0]]
    off = found.transform @ TURNED
    places = np.array(path)
    metres = np.linalg.norm(moved(off, places) - places, axis=1).max()
    degrees = np.degrees(np.linalg.norm(log_so3(off[None, :3, :3])[0]))
    return [
        name, f"{found.scans} of {found.of}", f"{100 * found.overlap:.0f} %",
        f"{found.residual_m:.3f} m, {found.residual_deg:.3f} degrees", f"{metres:.3f} m, {degrees:.3f} degrees", "-",
    ]  # fmt: skip


def main() -> None:
    """Print, and with --save write the table."""
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    words.add_argument("--cases", default=";".join(CASES), help="names, with semicolons between them")
    words.add_argument("--cache", type=Path, default=Path("build/maps"))
    words.add_argument("--save", action="store_true")
    asked = words.parse_args()
    rows = []
    for name in asked.cases.split(";"):
        rows.append(row_of(name, CASES[name], asked.cache))
        print(*rows[-1], sep="  ", flush=True)
    title = {"title": "Drives put into one map by their overlap"}
    if asked.save:
        results.write("maps/overlap", results.Result(results.here() | title, COLUMNS, rows))


if __name__ == "__main__":
    main()

"""`lidarcodec map build`: drives become a map."""

from __future__ import annotations

import logging
import math
import sys
import tempfile
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

from lidarcodec import __version__
from lidarcodec.commands.progress import progress
from lidarcodec.commands.running.stopping import StoppedError, stoppable
from lidarcodec.commands.running.telling import tell
from lidarcodec.commands.selection.numbers import numbers_of
from lidarcodec.commands.sources import check_finite, check_not_input, check_recorded
from lidarcodec.errors import LidarCodecError, SettingsError
from lidarcodec.evaluation.rigid import Matrix, exp_so3
from lidarcodec.files.folder_lock import alone_in
from lidarcodec.files.whole import check_free, whole
from lidarcodec.maps.build import MapBuilder
from lidarcodec.maps.drives import DriveSpec
from lidarcodec.maps.file import check_step
from lidarcodec.maps.geodesy import utm_of
from lidarcodec.maps.joining import Joined, Joining, Start
from lidarcodec.maps.kept_build import KeptBuild
from lidarcodec.maps.points import MapFrame
from lidarcodec.sensors.capture_names import stem_of
from lidarcodec.sensors.find import beside
from lidarcodec.sources.mounts import Mounted
from lidarcodec.sources.unkept import say_unkept

logger = logging.getLogger(__name__)

ENDING: Final = ".lcmap"
BUILDING: Final = ".building"
"""Ends the name of the folder beside the map with what was done, until it is whole."""
LATITUDES: Final = (-80.0, 84.0)
"""UTM covers these."""


@dataclass(frozen=True)
class Asked:
    """The options of `map build`."""

    sources: list[str]
    out: Path
    poses: list[Path]
    origin: str | None
    step_m: float
    least_seen: int
    every: int
    frames: int | None
    skip: int
    calibration: Path | None
    mounts: list[str] = field(default_factory=list)
    poses_of: str | None = None
    align: bool = False
    starts: list[str] = field(default_factory=list)

    def decides(self) -> dict[str, Any]:
        """All that decides what the map will hold, with the size and the time of the inputs, and of what lies beside
        them: calibrations, metadata."""
        sources = [Path(source.partition("?")[0]) for source in self.sources]
        inputs = [*sources, *self.poses, self.calibration]
        inputs += (Path(mount.rpartition("#")[0] or mount) for mount in self.mounts)  # FILE, FILE#SENSOR, or numbers
        for source in sources:
            inputs += [*beside(source), source.parent / f"{stem_of(source)}.json"]
        files = [None if path is None or not path.exists() else _version(path) for path in inputs]
        own = {key: value for key, value in asdict(self).items() if key != "out"}
        return {
            **own,
            "poses": [str(one) for one in self.poses],
            "calibration": str(self.calibration),
            "files": files,
            "version": __version__,
        }

    def first_poses(self) -> list[Start | None]:
        """Where the first scan of each drive is in the map; None if it is not said. Raises SettingsError."""
        if not self.starts:
            return [None] * len(self.sources)
        if len(self.starts) != len(self.sources) - 1:
            raise SettingsError(
                f"{len(self.sources)} sources have {len(self.starts)} starts: give --start once for each SOURCE after "
                "the first",
                "start",
            )
        form = "X,Y,YAW in metres and degrees of the map, as in 12.5,-3,90"
        return [None, *(Start(*numbers_of("--start", start, form, 3)) for start in self.starts)]

    def drives(self) -> list[DriveSpec]:
        """The drives with their poses. Raises SettingsError."""
        if self.poses and len(self.poses) != len(self.sources):
            raise SettingsError(
                f"{len(self.sources)} sources have {len(self.poses)} files of poses: give --poses once for each",
                "poses",
            )
        if len(self.mounts) not in (0, 1, len(self.sources)):
            raise SettingsError(
                f"{len(self.sources)} sources have {len(self.mounts)} mountings: give --mount once, or once for each",
                "mount",
            )
        mounts = self.mounts * len(self.sources) if len(self.mounts) == 1 else self.mounts
        none = [None] * len(self.sources)
        for source in self.sources:
            check_recorded(source)
            check_finite(source, self.frames)
            check_not_input(self.out, source)
        return [
            DriveSpec(
                source, poses, self.calibration, self.frames, self.skip, self.every,
                Mounted.of(mount, self.poses_of, poses=poses is not None),
            )
            for source, poses, mount in zip(
                self.sources, self.poses or none, mounts or none, strict=True
            )
        ]  # fmt: skip


def _version(path: Path) -> list[int]:
    """Number of files, their bytes, and the time of the last change."""
    found = [one.stat() for one in (path.rglob("*") if path.is_dir() else [path])]
    return [len(found), sum(one.st_size for one in found), max((one.st_mtime_ns for one in found), default=0)]


def check_map_name(path: Path, *, force: bool) -> None:
    """Raise SettingsError if a map cannot have this name."""
    if path.suffix.lower() != ENDING:
        raise SettingsError(f"the name of a map must end in {ENDING}, not {path.name}", "out")
    check_free(path, force=force)


def placed(origin: str | None) -> tuple[Matrix, MapFrame]:
    """T_map_world (4, 4) and the frame of the map for `--origin`. Raises SettingsError."""
    if origin is None:
        return np.eye(4), MapFrame()
    form = "LAT,LON,HEADING in degrees, as in 49.01,8.43,90"
    latitude, longitude, heading = numbers_of("--origin", origin, form, 3)
    if not (LATITUDES[0] <= latitude <= LATITUDES[1] and abs(longitude) <= 180):
        raise SettingsError(f"--origin {origin}: UTM covers latitudes -80 to 84 and longitudes -180 to 180", "origin")
    east, north, zone, convergence = utm_of(latitude, longitude)
    T_map_world = np.eye(4)
    T_map_world[:3, :3] = exp_so3(np.array([0.0, 0.0, math.radians(90 - heading + convergence)]))
    T_map_world[:2, 3] = east, north
    return T_map_world, MapFrame(zone, latitude < 0, (latitude, longitude, heading))


def run(asked: Asked, force: bool, as_json: bool) -> None:
    """Write the map, and print what it holds."""
    check_map_name(asked.out, force=force)
    check_step(round(asked.step_m * 1e6))
    drives = asked.drives()
    T_map_world, frame = placed(asked.origin)
    starts = asked.first_poses()
    step_um = round(asked.step_m * 1e6)
    folder = asked.out.with_name(asked.out.name + BUILDING)
    with (
        stoppable() as stopped,
        alone_in(folder),
        tempfile.TemporaryDirectory(prefix="lidarcodec-map-") as passing,
        progress("building a map", asked.frames if len(drives) == 1 else None) as draw,
    ):
        kept = KeptBuild(folder, asked.decides(), force=force)
        builder = MapBuilder(folder, step_um, frame, asked.least_seen)
        kept.go_on(builder)
        if kept.saved:
            sys.stderr.write(f"lidarcodec: going on with {folder}: {kept.scans} scans are in the map\n")

        def tick() -> None:
            draw()
            if stopped() or kept.due():
                kept.save(builder)
            if stopped():
                raise StoppedError(f"stopped: run the same command again, and it goes on; {folder} has what was done")

        try:
            with whole(asked.out, force=force) as output:
                joining = Joining(builder, T_map_world, Path(passing), kept, tick)
                joined = joining.add(drives, align=asked.align, starts=starts)
                with output.beside.open("w+b") as file:
                    points_written = builder.write(file, tick)
                    size = file.tell()
        except LidarCodecError:
            if kept.saved:
                logger.warning("%s has what was done: the same command goes on there", folder)
            else:
                kept.clear()
            raise
        kept.clear()
    for drive in drives:
        say_unkept(drive.spec, drive.unkept)
    found = {
        "output": str(output.kept or asked.out),
        "scans": builder.scans,
        "length_m": round(builder.length_m, 1),
        "points": points_written,
        "bytes": size,
        "moving": builder.moving,
        "seldom": builder.seldom,
        "aligned": [_alignment(one) for one in joined if one.alignment is not None],
    }
    text = (
        f"{found['output']}: {points_written:,} points of {builder.scans} scans over {builder.length_m:.1f} m, "
        f"{size:,} bytes; left out: {builder.moving:,} cells that were seen through, {builder.seldom:,} that fewer "
        f"than {asked.least_seen} scans hit"
    )
    tell(found, "\n".join([text, *(_said(one) for one in joined if one.alignment is not None)]), as_json)


def _alignment(one: Joined) -> dict[str, Any]:
    """What --json says of a drive that was aligned."""
    found = one.alignment
    assert found is not None
    return {
        "source": one.drive.spec,
        "transform": [[round(value, 6) for value in row] for row in found.transform.tolist()],
        "scans": found.scans,
        "of": found.of,
        "overlap": round(found.overlap, 3),
        "residual_m": round(found.residual_m, 4),
        "residual_deg": round(found.residual_deg, 4),
    }


def _said(one: Joined) -> str:
    found = one.alignment
    assert found is not None
    x, y, z = found.transform[:3, 3]
    yaw = math.degrees(math.atan2(found.transform[1, 0], found.transform[0, 0]))
    return (
        f"{one.drive.spec}: aligned by overlap, moved by {x:.2f}, {y:.2f}, {z:.2f} m and turned by {yaw:.2f} degrees; "
        f"{found.scans} of {found.of} scans in the map of the others fit to {found.residual_m:.3f} m and "
        f"{found.residual_deg:.3f} degrees; {100 * found.overlap:.0f} % of its way lies there"
    )

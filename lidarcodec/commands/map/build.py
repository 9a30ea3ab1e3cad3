"""`lidarcodec map build`: drives become a map."""

from __future__ import annotations

import math
import tempfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np

from lidarcodec.commands.progress import progress
from lidarcodec.commands.running.telling import tell
from lidarcodec.commands.selection.numbers import numbers_of
from lidarcodec.commands.sources import check_finite, check_not_input, check_recorded
from lidarcodec.errors import SettingsError
from lidarcodec.evaluation.rigid import Matrix, exp_so3, moved
from lidarcodec.files.whole import check_free, whole
from lidarcodec.maps.build import MapBuilder
from lidarcodec.maps.drives import DriveSpec, world_scans
from lidarcodec.maps.file import check_step
from lidarcodec.maps.geodesy import utm_of
from lidarcodec.maps.points import MapFrame
from lidarcodec.sources.mounts import Mounted

ENDING: Final = ".lcmap"
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
    with (
        whole(asked.out, force=force) as output,
        tempfile.TemporaryDirectory(prefix="lidarcodec-map-") as folder,
        progress("building a map", asked.frames and asked.frames * len(drives)) as tick,
    ):
        builder = MapBuilder(Path(folder), round(asked.step_m * 1e6), frame, asked.least_seen)
        for scans in world_scans(drives, tick):
            builder.start_drive()
            for points, pose in scans:
                builder.add(moved(T_map_world, points), T_map_world @ pose)
                tick()
        with output.beside.open("w+b") as file:
            points_written = builder.write(file, tick)
            size = file.tell()
    found = {
        "output": str(output.kept or asked.out),
        "scans": builder.scans,
        "length_m": round(builder.length_m, 1),
        "points": points_written,
        "bytes": size,
        "moving": builder.moving,
        "seldom": builder.seldom,
    }
    text = (
        f"{found['output']}: {points_written:,} points of {builder.scans} scans over {builder.length_m:.1f} m, "
        f"{size:,} bytes; left out: {builder.moving:,} cells that were seen through, {builder.seldom:,} that fewer "
        f"than {asked.least_seen} scans hit"
    )
    tell(found, text, as_json)

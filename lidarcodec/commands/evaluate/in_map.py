"""`lidarcodec evaluate localisation --map town.lcmap`: how well the scans of drives are found in maps that exist."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from lidarcodec.commands.progress import progress
from lidarcodec.commands.running.stopping import StoppedError, interrupted_after
from lidarcodec.commands.running.telling import tell
from lidarcodec.commands.sources import check_finite
from lidarcodec.errors import SettingsError
from lidarcodec.evaluation.localisation.drive import read_drive
from lidarcodec.evaluation.localisation.protocol import scored_frames
from lidarcodec.evaluation.localisation.reference import find_reference
from lidarcodec.evaluation.report import aligned
from lidarcodec.evaluation.rigid import Matrix
from lidarcodec.maps.file import MapReader
from lidarcodec.maps.localise.accuracy import SCANS, Scans, WindowWorld, accuracy, seen
from lidarcodec.maps.localise.window import MapWindow

ENDING = ".lcmap"


@dataclass(frozen=True)
class Asked:
    """The options of `evaluate localisation` that a map in a file leaves."""

    sources: list[str]
    maps: list[str]
    stride: int
    seed: int
    frames: int | None
    skip: int
    calibration: Path | None
    poses: Path | None

    def check(self, others: dict[str, Any]) -> None:
        """Raise SettingsError for maps that are no files, and for options that are not for them."""
        for name in self.maps:
            if not name.endswith(ENDING):
                raise SettingsError(f"--map {name} cannot be combined with map files: give only files, or none", "map")
        for option, value in others.items():
            if value:
                raise SettingsError(
                    f"{option} cannot be combined with map files: the scans are used with all their returns",
                    option.lstrip("-"),
                )
        for source in self.sources:
            check_finite(source, self.frames)
        if self.poses is not None and len(self.sources) > 1:
            raise SettingsError("--poses works with a single source only", "poses")


def run(asked: Asked, as_json: bool) -> None:
    """Look for every `stride`-th scan of every source in every map, and print the errors."""
    found: list[dict[str, Any]] = []
    wanted = len(asked.sources) * len(asked.maps) * len(SCANS)
    with ExitStack() as opened:
        readers = [opened.enter_context(MapReader.open(Path(name))) for name in asked.maps]
        with suppress(KeyboardInterrupt):
            for source in asked.sources:
                with progress(source) as tick:
                    _of_source(asked, source, readers, found, tick)
    done = len(found)
    end = [] if done == wanted else [interrupted_after(done, wanted)]
    tell(found + end, "\n".join(aligned([list(_CELLS), *map(_cells, found)])), as_json)
    if done < wanted:
        raise StoppedError(f"stopped: the output has only {done} of {wanted} results")


def _of_source(
    asked: Asked, source: str, readers: list[MapReader], found: list[dict[str, Any]], tick: Callable[[], None]
) -> None:
    drive = read_drive(
        source, frames=asked.frames, skip=asked.skip, calibration=asked.calibration, poses=asked.poses, tick=tick
    )
    reference = find_reference(drive, "given")
    frames = scored_frames(len(drive.frames), asked.stride).tracked

    def cloud(scans: Scans, at: int) -> Matrix:
        tick()
        return seen(scans, drive.cloud(at, reference.velocities[at]), asked.seed + at)

    for name, reader in zip(asked.maps, readers, strict=True):
        for scans in SCANS:
            world = WindowWorld(MapWindow(reader))
            errors = accuracy(world, partial(cloud, scans), reference.poses, frames, asked.seed)
            found.append({"source": source, "map": name, "scans": scans, **errors})


_CELLS = ("source", "map", "scans", "mm", "degrees", "p95 mm", "lost")


def _cells(one: dict[str, Any]) -> list[str]:
    millimetres, degrees = "-", "-"
    if one["mate_m"] is not None:
        error = "" if one["mate_m_error"] is None else f" +- {1000 * one['mate_m_error']:.1f}"
        millimetres, degrees = f"{1000 * one['mate_m']:.1f}{error}", f"{one['angle_deg']:.4f}"
    p95 = "-" if one["p95_m"] is None else f"{1000 * one['p95_m']:.1f}"
    return [one["source"], one["map"], one["scans"], millimetres, degrees, p95, f"{one['lost']} of {one['of']}"]

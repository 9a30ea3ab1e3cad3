"""False places: whether `localise` ever says that a sensor is where it is not.

    python -m benchmarks.false_places --set chosen|apart --cache DIR [--drives road-1,...] [--jobs 2] [--save]

Each drive is looked for in a map of another drive through the same place, at another speed and among other traffic: the
whole map, and a twentieth of its points. The scans are whole, or thinned by lot to 2 % of their returns. A start is
given where the sensor is, 3 m ahead of it, or 3 m behind and 10 degrees askew, which is within what `--start` promises.
Elsewhere the same starts are given in the map of another place of the same kind.

A pose that is claimed is wrong if it is off by more than 0.5 m and by more than four times its standard deviation in
the worst direction. Elsewhere every claimed pose is wrong. Limits may be chosen by the drives of `chosen` only; those
of `apart` have other seeds and other sensors, and are run once, when nothing is chosen any more.
"""

from __future__ import annotations

import argparse
import itertools
import os
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from benchmarks import results
from lidarcodec import read_frames
from lidarcodec.evaluation.localisation.drive import read_drive
from lidarcodec.evaluation.rigid import Matrix, moved
from lidarcodec.evaluation.trajectory import Scan, Trajectory, scan_of
from lidarcodec.maps.build import MapBuilder
from lidarcodec.maps.compress import compressed
from lidarcodec.maps.file import MapReader, write_map
from lidarcodec.maps.localise.accuracy import THINNED
from lidarcodec.maps.localise.localiser import Localiser
from lidarcodec.maps.localise.tracker import sigma_m
from lidarcodec.maps.world import FEWEST
from lidarcodec.sources import open_source

MAP_SPEED: Final = {"road": 16, "motorway": 22, "bend": 11, "city": 9, "street": 9}
DRIVE_SPEEDS: Final = {"road": (13, 25), "motorway": (33, 24), "bend": (13, 9), "city": (11, 7), "street": (11, 7)}
MAP_FRAMES: Final = 90
FRAMES: Final = 45
BEGINS: Final = (5, 15, 25)
"""Scan at which each of the starts is given."""
STARTS: Final = ((0.0, 0.0, 0.0), (3.0, 0.0, 0.0), (-2.5, 1.5, 10.0))
"""Metres ahead and to the left of the sensor, and degrees, of each of the starts."""
MAPS: Final = ("whole", "5 %", "5 %")
"""The map of each of the starts."""
AWAY_M: Final = (0.0, 20.0, 40.0)
"""So much farther ahead they are in the map of another place, because posts of all simulated roads are at one place."""
SCANS: Final = 16
"""After a start. A run ends before where the start does not fit."""
SHARE: Final = 0.05
STEP_UM: Final = 20_000
OFF_M: Final = 0.5
SIGMAS: Final = 4.0
SEEDS: Final = {
    "chosen": {"road": (1, 2), "motorway": (1, 2), "bend": (1, 3), "city": (1, 3)},
    "apart": {"road": (5, 8), "motorway": (6, 9), "bend": (4, 7), "street": (5, 6)},
}
"""Seeds of the scenes of each set."""
SENSORS: Final = {"chosen": ("vlp16", "os1-64", "pandar64"), "apart": ("hdl32e", "os0-32", "xt32")}
"""Beside an HDL-64E."""


class Found(NamedTuple):
    """What came of one start. claimed: poses; wrong: of them; worst_m, sigmas: largest error, in metres and in standard
    deviations; first: scan of the first pose; ms: median time of a scan that is tracked, of a core"""

    claimed: int
    wrong: int
    worst_m: float
    sigmas: float
    first: int
    ms: float

    @property
    def word(self) -> str:
        """Wrong, right, or without a pose."""
        return "wrong" if self.wrong else "right" if self.claimed else "no pose"


class Run(NamedTuple):
    """One start of a drive. here: whether the map is of the same place"""

    drive: str
    sensor: str
    scans: str
    map: str
    here: bool
    start: int
    found: Found


def drives_of(name: str) -> list[str]:
    """Names of the drives of a set, such as `road-1`."""
    return [f"{scene}-{seed}" for scene, seeds in SEEDS[name].items() for seed in seeds]


def pairs_of(name: str) -> list[tuple[str, str]]:
    """Drives with their sensors: an HDL-64E, and one of the others in turn."""
    sensors = itertools.cycle(SENSORS[name])
    return [(drive, sensor) for drive in drives_of(name) for sensor in ("hdl64e", next(sensors))]


def elsewhere(name: str, drive: str) -> str:
    """The drive of the same scene with another seed."""
    scene, seed = drive.split("-")
    seeds = SEEDS[name][scene]
    return f"{scene}-{seeds[1 - seeds.index(int(seed))]}"


def maps_of(drive: str, cache: Path) -> dict[str, Path]:
    """Files of the whole map of a drive, and of the small one; kept in the folder."""
    files = {"whole": cache / f"{drive}.lcmap", "5 %": cache / f"{drive}-5.lcmap"}
    if not files["5 %"].exists():
        scene, seed = drive.split("-")
        spec = f"sim:{scene}?seed={seed}&frames={MAP_FRAMES}&speed={MAP_SPEED[scene]}"
        read = read_drive(spec)
        assert read.poses is not None
        poses = Trajectory.from_poses(read.poses, [int(stamp) for stamp in read.stamps_ns])
        with tempfile.TemporaryDirectory() as folder:
            builder = MapBuilder(Path(folder), STEP_UM)
            for at in range(len(poses)):
                builder.add(moved(poses.matrices[at], read.cloud(at, poses.velocities[at])), poses.matrices[at])
            with files["whole"].open("w+b") as file:
                builder.write(file)
        with MapReader.open(files["whole"]) as reader:
            points = reader.points()
        small, _ = compressed(points, "greedy", int(SHARE * len(points)))
        with files["5 %"].open("w+b") as file:
            write_map(file, small)
    return files


def scans_of(drive: str, sensor: str) -> tuple[list[Scan], Matrix]:
    """The scans of a sensor on its drive, and its true poses (F, 4, 4)."""
    scene, seed = drive.split("-")
    speed = DRIVE_SPEEDS[scene][int(seed) % 2]
    with open_source(f"sim:{scene}?seed={seed}&frames={FRAMES}&speed={speed}&sensor={sensor}") as source:
        scans = [scan_of(frame) for frame in itertools.islice(read_frames(source), FRAMES)]
        poses = source.poses
        assert poses is not None
        scans = scans[1:-1]  # the outermost turns are not whole
        return scans, Trajectory.from_poses(poses, [scan.stamp_ns for scan in scans]).matrices


def thinned(scan: Scan, seed: int) -> Scan:
    """A scan with 2 % of its returns, by lot."""
    count = max(round(THINNED * len(scan.points)), FEWEST)
    kept = np.sort(np.random.default_rng(seed).permutation(len(scan.points))[:count])
    return Scan(scan.stamp_ns, scan.points[kept], scan.after_s[kept])


def run(path: Path, scans: list[Scan], poses: Matrix, start: int, away_m: float = 0.0) -> Found:
    """What is said of the scans from a start on, in a map. Nothing is searched where the start does not fit."""
    begin, (ahead, left, degrees) = BEGINS[start], STARTS[start]
    at = poses[begin] @ np.array([ahead + away_m, left, 0.0, 1.0])
    yaw = np.degrees(np.arctan2(poses[begin, 1, 0], poses[begin, 0, 0])) + degrees
    off, sigmas, firsts, times = list[float](), list[float](), list[int](), list[float]()
    with Localiser(path) as localiser:
        localiser.start(float(at[0]), float(at[1]), float(yaw))
        tracker = localiser.tracker
        for number in range(begin, min(begin + SCANS, len(scans))):
            before, began = tracker.state, time.thread_time()
            estimate = tracker.track(scans[number])
            if before == estimate.state == "tracking":
                times.append(time.thread_time() - began)
            if estimate.pose is not None and estimate.covariance is not None:
                off.append(float(np.linalg.norm(estimate.pose[:3, 3] - poses[number][:3, 3])))
                sigmas.append(sigma_m(estimate.covariance))
                firsts.append(number - begin)
            elif tracker.unknown and not off:
                break
    wrong = sum(error > max(OFF_M, SIGMAS * sigma) for error, sigma in zip(off, sigmas, strict=True))
    worst = max((error / sigma for error, sigma in zip(off, sigmas, strict=True)), default=0.0)
    ms = 1000 * float(np.median(times)) if times else 0.0
    return Found(len(off), wrong, max(off, default=0.0), worst, firsts[0] if firsts else -1, ms)


def runs_of(name: str, drive: str, sensor: str, cache: Path) -> list[Run]:
    """All runs of a sensor on a drive."""
    scans, poses = scans_of(drive, sensor)
    files, other = maps_of(drive, cache), maps_of(elsewhere(name, drive), cache)["whole"]
    runs = []
    for kind, seen in (("whole", scans), ("2 %", [thinned(scan, at) for at, scan in enumerate(scans)])):
        for start, what in enumerate(MAPS):
            found = run(files[what], seen, poses, start)
            runs.append(Run(drive, sensor, kind, what, True, start, found))
        for start, away_m in enumerate(AWAY_M):
            found = run(other, seen, poses, start, away_m)
            runs.append(Run(drive, sensor, kind, "whole", False, start, found._replace(wrong=found.claimed)))
    return runs


COLUMNS: Final = [
    "drives", "sensor", "scans", "right", "no pose", "wrong", "largest error, m", "largest error, sigmas",
    "elsewhere: no pose", "elsewhere: wrong", "first pose after, scans", "ms a scan",
]  # fmt: skip


def row_of(label: list[str], runs: list[Run]) -> list[str]:
    """A row of the table."""
    here, away = ([one.found for one in runs if one.here is which] for which in (True, False))
    words = [one.word for one in here]
    claimed = [one for one in here if one.claimed]
    return [
        *label,
        *(str(words.count(word)) for word in ("right", "no pose", "wrong")),
        f"{max((one.worst_m for one in claimed), default=0.0):.2f}",
        f"{max((one.sigmas for one in claimed), default=0.0):.1f}",
        str(sum(not one.claimed for one in away)),
        str(sum(one.claimed > 0 for one in away)),
        f"{np.median([one.first for one in claimed]):.0f}" if claimed else "-",
        f"{np.median([one.ms for one in claimed]):.0f}" if claimed else "-",
    ]


def rows_of(runs: list[Run]) -> Iterator[list[str]]:
    """The table: by scene, sensor and kind of scan, and all together."""

    def scene_of(one: Run) -> str:
        return one.drive.split("-")[0]

    for scene in dict.fromkeys(map(scene_of, runs)):
        for sensor in dict.fromkeys(one.sensor for one in runs):
            for scans in ("whole", "2 %"):
                same = [one for one in runs if (scene_of(one), one.sensor, one.scans) == (scene, sensor, scans)]
                if same:
                    yield row_of([scene, sensor, scans], same)
    for scans in ("whole", "2 %"):
        yield row_of(["all", "all", scans], [one for one in runs if one.scans == scans])


def main() -> None:
    """Print, and with --save write the table."""
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    words.add_argument("--set", choices=list(SEEDS), default="chosen")
    words.add_argument("--drives", help="default: all of the set")
    words.add_argument("--cache", type=Path, default=Path("build/false-places"))
    words.add_argument("--jobs", type=int, default=1, help="processes")
    words.add_argument("--save", action="store_true")
    asked = words.parse_args()
    drives = asked.drives.split(",") if asked.drives else drives_of(asked.set)
    pairs = [(drive, sensor) for drive, sensor in pairs_of(asked.set) if drive in drives]
    asked.cache.mkdir(parents=True, exist_ok=True)
    os.environ["OMP_NUM_THREADS"] = "1"
    runs: list[Run] = []
    with ProcessPoolExecutor(asked.jobs, mp_context=get_context("spawn")) as pool:
        needed = sorted({*drives, *(elsewhere(asked.set, drive) for drive in drives)})
        list(pool.map(maps_of, needed, itertools.repeat(asked.cache)))
        made = [pool.submit(runs_of, asked.set, *one, asked.cache) for one in pairs]
        for ready in made:
            for one in ready.result():
                place = "here" if one.here else "elsewhere"
                print(*one[:4], place, one.start, one.found.word, one.found, flush=True)
                runs.append(one)
    rows = list(rows_of(runs))
    for row in [COLUMNS, *rows]:
        print(*row, sep=" | ")
    if asked.save:
        title = {
            "chosen": "Places that `localise` says: drives that its limits were chosen by",
            "apart": "Places that `localise` says: drives kept apart",
        }[asked.set]
        about = f"{len(runs)} starts, {SCANS} scans after each. A run is wrong if one of its poses is."
        fields = results.here() | {"title": title, "about": about}
        results.write(f"maps/places-{asked.set}", results.Result(fields, COLUMNS, rows))


if __name__ == "__main__":
    main()

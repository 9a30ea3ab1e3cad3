"""Maps for localisation: how well scans are found in reduced maps, and how small their files are.

    python -m benchmarks.maps --drives road,city,0013,0005 --cache DIR --save

The map of a drive is of the scans that are not looked for. Every third scan is looked for, from the last estimate, as
`evaluate localisation --protocol track` does; a scan is the means of 0.5 m cells. Poses are exact for simulated drives,
otherwise refined from the scans and kept in DIR. All maps of a share have the bytes of the greedy one, to about a
percent. Peers code the very points of a map, on its grid. `--page` writes the tables into docs/guides/maps.md.
"""

from __future__ import annotations

import argparse
import io
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path
from typing import Final

import numpy as np

from benchmarks import results
from benchmarks.marks import Marks
from benchmarks.scenes import DATA
from lidarcodec.evaluation.localisation.drive import read_drive
from lidarcodec.evaluation.localisation.errors import pose_errors
from lidarcodec.evaluation.localisation.protocol import Scored, judged, scored_frames, track
from lidarcodec.evaluation.localisation.reference import find_reference
from lidarcodec.evaluation.rigid import Matrix, moved
from lidarcodec.evaluation.trajectory import Trajectory, voxel_means
from lidarcodec.maps.build import MapBuilder
from lidarcodec.maps.compress import bare, compressed, file_bytes
from lidarcodec.maps.file import MapReader
from lidarcodec.maps.points import MapPoints
from lidarcodec.maps.world import MapWorld

DRIVES: Final = {
    "road": "sim:road?frames=150",
    "city": "sim:city?frames=150",
    "0013": str(DATA / "kitti_0013_f052-107.pcap.xz"),
    "0005": str(DATA / "kitti_0005.pcap.xz"),
}
CALIBRATION: Final = DATA / "kitti_hdl64e_s2_recovered_db.xml"
PAGE: Final = Path(__file__).resolve().parents[1] / "docs" / "guides" / "maps.md"
SHARES: Final = (0.05, 0.02, 0.2, 0.1)
METHODS: Final = ("greedy", "lp", "voxel", "random")
STRIDE: Final = 3
STEP_UM: Final = 20_000
LEAST_SEEN: Final = 2
SCAN_CELL_M: Final = 0.5
ROUNDS: Final = 4
SEED: Final = 1


@dataclass(frozen=True)
class Case:
    """A drive: its poses, its scans that are looked for, and its whole map."""

    name: str
    poses: Trajectory
    scored: Scored
    whole: MapPoints
    clouds: dict[int, Matrix]


def case_of(name: str, cache: Path) -> Case:
    """Read a drive and build its map; poses are kept in the folder `cache`."""
    drive = read_drive(DRIVES[name], calibration=None if DRIVES[name].startswith("sim:") else CALIBRATION)
    kept = cache / f"{name}-traj.npz"
    if not kept.exists():
        cache.mkdir(parents=True, exist_ok=True)
        find_reference(drive).trajectory.save(kept)
    poses = Trajectory.load(kept)
    scored = scored_frames(len(drive.frames), STRIDE)
    looked_for = set(scored.tracked.tolist())
    with tempfile.TemporaryDirectory() as folder:
        builder = MapBuilder(Path(folder), STEP_UM, least_seen=LEAST_SEEN)
        for at in range(len(drive.frames)):
            if at not in looked_for:
                builder.add(moved(poses.matrices[at], drive.cloud(at, poses.velocities[at])), poses.matrices[at])
        file = io.BytesIO()
        builder.write(file)
    clouds = {at: voxel_means(drive.cloud(at, poses.velocities[at]), SCAN_CELL_M) for at in scored.tracked.tolist()}
    return Case(name, poses, scored, MapReader(file).points(), clouds)


def at_bytes(points: MapPoints, by: str, size: int, count: int) -> MapPoints:
    """A map by a method with a file of about `size` bytes; count: number of points to begin with."""
    made, _ = compressed(points, by, count, SEED)
    for _ in range(ROUNDS):
        bytes_ = file_bytes(made)
        if abs(bytes_ / size - 1) < 0.01:
            break
        count = min(max(round(count * size / bytes_), 100), len(points))
        made, _ = compressed(points, by, count, SEED)
    return made


def accuracy(case: Case, points: MapPoints) -> list[str]:
    """The mean error in millimetres, and how many steps were lost."""
    found = track(MapWorld(points), case.clouds.__getitem__, case.poses.matrices, case.scored.tracked)
    judgement = judged("track", pose_errors(found, case.poses.matrices[case.scored.tracked]), SEED)
    mean, error = judgement["mate_m"], judgement["mate_m_error"]
    millimetres = "-" if mean is None else f"{1000 * mean:.1f} +- {1000 * (error or 0):.1f}"
    return [millimetres, f"{judgement['lost']} of {judgement['of']}"]


def row_of(case: Case, share: str, by: str, points: MapPoints) -> list[str]:
    """A row of the table of localisation."""
    size = file_bytes(points)
    return [
        f"{case.name} {share} {by}", f"{len(points):,}", f"{size / 1000:,.1f}",
        f"{size / 1000 / case.whole.length_m:.3f}", f"{8 * size / len(points):.1f}", *accuracy(case, points),
    ]  # fmt: skip


def whole_rows(case: Case) -> Iterator[list[str]]:
    """A row for the whole map."""
    yield row_of(case, "100 %", "whole", bare(case.whole))


def share_rows(case: Case, share: float) -> Iterator[list[str]]:
    """A row for each method, all with the bytes of the greedy one."""
    count, size = int(share * len(case.whole)), 0
    for by in METHODS:
        points = at_bytes(case.whole, by, size, count) if size else compressed(case.whole, by, count, SEED)[0]
        size = size or file_bytes(points)
        yield row_of(case, f"{100 * share:g} %", by, points)


def peer_rows(case: Case) -> Iterator[list[str]]:
    """Bits a point of positions alone, of the whole map and of the greedy and random ones."""
    for share in (1.0, 0.2, 0.05):
        for by in ("greedy", "random")[: 1 if share == 1 else 2]:
            count = int(share * len(case.whole))
            points = case.whole if share == 1 else compressed(case.whole, by, count, SEED)[0]
            only = bare(points).with_columns()
            sizes = {
                "ours": file_bytes(only),
                "Draco": draco(only),
                "LASzip": laszip(only),
                "PCD": 12 * len(only) + 200,
            }
            ours = sizes["ours"]
            yield [
                f"{case.name} {100 * share:g} % {'whole' if share == 1 else by}",
                f"{len(only):,}",
                *(f"{8 * size / len(only):.2f}" for size in sizes.values()),
                *(f"{100 * (1 - ours / sizes[peer]):.1f} %" for peer in ("Draco", "LASzip")),
            ]


def draco(points: MapPoints) -> int:
    """Bytes of Draco's point cloud (kd-tree, level 10), on the same grid without loss."""
    import DracoPy

    steps = points.steps - points.steps.min(axis=0)
    bits = int(steps.max()).bit_length()
    data = DracoPy.encode(
        steps.astype(np.float32), quantization_bits=bits, compression_level=10, quantization_range=float(2**bits - 1),
        quantization_origin=[0, 0, 0], create_metadata=False,
    )  # fmt: skip
    return len(data)


def laszip(points: MapPoints) -> int:
    """Bytes of a LAZ file in the better of two orders, by place and by Morton code."""
    import laspy

    steps = points.steps - points.steps.min(axis=0)
    codes = np.zeros(len(steps), np.int64)
    for bit in range(20):
        for axis in range(3):
            codes |= ((steps[:, axis] >> bit) & 1) << (3 * bit + axis)
    sizes = []
    for order in (np.lexsort(steps.T[::-1]), np.argsort(codes)):
        header = laspy.LasHeader(point_format=0, version="1.2")
        header.scales, header.offsets = np.full(3, points.step_m), np.zeros(3)
        las = laspy.LasData(header)
        las.X, las.Y, las.Z = steps[order].T.astype(np.int32)
        file = io.BytesIO()
        las.write(file, do_compress=True)
        sizes.append(len(file.getvalue()))
    return min(sizes)


TABLES: Final = {
    "localisation": ("Localisation in reduced maps", ["map", "points", "kB", "MB/km", "bits/point", "mm", "lost"]),
    "size": ("Positions of maps", ["map", "points", "ours", "Draco", "LASzip", "PCD", "under Draco", "under LASzip"]),
}
"""Title and columns of each table, by the name of its result."""


def order_of(label: str) -> tuple[int, float]:
    """Rows are ordered by drive, then by share, the largest first; methods stay in their order."""
    drive, share, *_ = label.split()
    return list(DRIVES).index(drive), -float(share)


def write_page() -> None:
    """Put the tables into the guide."""
    for name in TABLES:
        result = results.read(f"maps/{name}")
        marks = Marks(f"<!-- figures: maps/{name} -->", f"<!-- end of maps/{name} -->")
        marks.write(PAGE, f"{result.markdown()}\n\n{result.where()}")


def main() -> None:
    """Print, and with --save write, both tables after each drive."""
    words = argparse.ArgumentParser(description=__doc__)
    words.add_argument("--drives", default=",".join(DRIVES))
    words.add_argument("--cache", type=Path, default=Path("build/maps"))
    words.add_argument("--save", action="store_true")
    words.add_argument("--page", action="store_true")
    asked = words.parse_args()
    found: dict[str, list[list[str]]] = {name: [] for name in TABLES}
    cases = [] if asked.page else [case_of(drive, asked.cache) for drive in asked.drives.split(",")]
    parts: list[tuple[str, Callable[[Case], Iterator[list[str]]]]] = [("localisation", whole_rows)]
    parts += [("localisation", partial(share_rows, share=share)) for share in SHARES]
    parts.insert(2, ("size", peer_rows))
    for (name, make), case in product(parts, cases):
        for row in make(case):
            print(*row, sep="  ", flush=True)
            found[name].append(row)
            title, columns = TABLES[name]
            if asked.save:
                ordered = sorted(found[name], key=lambda one: order_of(one[0]))
                results.write(f"maps/{name}", results.Result(results.here() | {"title": title}, columns, ordered))
    if asked.page:
        write_page()


if __name__ == "__main__":
    main()

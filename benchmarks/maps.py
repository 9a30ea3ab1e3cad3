"""Maps for localisation: how well scans are found in reduced maps, and how small their files are.

    python -m benchmarks.maps --drives road,city,0013,0005 --cache DIR --save

The map of a drive is of the scans that are not looked for. Every third scan is looked for, from the last estimate, as
`evaluate localisation --map FILE` does: means of 0.5 m cells of the whole scan, and 2 % of its returns. Poses are exact
for simulated drives, otherwise refined from the scans and kept in DIR. All maps of a share have the bytes of the random
one, to about a percent. Peers code the very points of a map, on its grid. With `--save` each row takes the place of the
row of its name in the result files.
"""

from __future__ import annotations

import argparse
import io
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path
from typing import Final

import numpy as np

from benchmarks import results
from benchmarks.scenes import DATA
from lidarcodec.evaluation.localisation.drive import read_drive
from lidarcodec.evaluation.localisation.protocol import Scored, scored_frames
from lidarcodec.evaluation.localisation.reference import find_reference
from lidarcodec.evaluation.rigid import Matrix, moved
from lidarcodec.evaluation.trajectory import Trajectory
from lidarcodec.maps.build import MapBuilder
from lidarcodec.maps.compress import bare, compressed, file_bytes
from lidarcodec.maps.file import MapReader
from lidarcodec.maps.localise.accuracy import SCANS, Scans, accuracy, seen
from lidarcodec.maps.points import MapPoints
from lidarcodec.maps.world import MapWorld

DRIVES: Final = {
    "road": "sim:road?frames=150",
    "city": "sim:city?frames=150",
    "0013": str(DATA / "kitti_0013_f052-107.pcap.xz"),
    "0005": str(DATA / "kitti_0005.pcap.xz"),
}
CALIBRATION: Final = DATA / "kitti_hdl64e_s2_recovered_db.xml"
SHARES: Final = (0.05, 0.2, 0.02, 0.1, 0.15)
METHODS: Final = ("random", "voxel", "paper", "greedy")
STRIDE: Final = 3
STEP_UM: Final = 20_000
LEAST_SEEN: Final = 2
ROUNDS: Final = 4
SEED: Final = 1


@dataclass(frozen=True)
class Case:
    """A drive: its poses, its scans that are looked for, and its whole map."""

    name: str
    poses: Trajectory
    scored: Scored
    whole: MapPoints
    clouds: dict[Scans, dict[int, Matrix]]


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
    clouds: dict[Scans, dict[int, Matrix]] = {scans: {} for scans in SCANS}
    for at in scored.tracked.tolist():
        cloud = drive.cloud(at, poses.velocities[at])
        for scans in SCANS:
            clouds[scans][at] = seen(scans, cloud, SEED + at)
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


def localised(case: Case, points: MapPoints) -> list[str]:
    """For whole and for thinned scans: the mean error in millimetres, degrees, and how many steps were lost."""
    world, cells = MapWorld(points), list[str]()
    for scans in SCANS:
        found = accuracy(world, case.clouds[scans].__getitem__, case.poses.matrices, case.scored.tracked, SEED)
        mean, error = found["mate_m"], found["mate_m_error"]
        cells.append("-" if mean is None else f"{1000 * mean:.1f} +- {1000 * (error or 0):.1f}")
        cells.append("-" if mean is None else f"{found['angle_deg']:.4f}")
        cells.append(f"{found['lost']} of {found['of']}")
    return cells


def row_of(case: Case, share: str, by: str, points: MapPoints) -> list[str]:
    """A row of the table of localisation."""
    size = file_bytes(points)
    return [
        f"{case.name} {share} {by}", f"{len(points):,}", f"{size / 1000:,.1f}",
        f"{size / 1000 / case.whole.length_m:.3f}", f"{8 * size / len(points):.1f}", *localised(case, points),
    ]  # fmt: skip


def whole_rows(case: Case) -> Iterator[list[str]]:
    """A row for the whole map."""
    yield row_of(case, "100 %", "whole", bare(case.whole))


def share_rows(case: Case, share: float, methods: Sequence[str]) -> Iterator[list[str]]:
    """A row for each method, all with the bytes of the random one."""
    count = int(share * len(case.whole))
    first = compressed(case.whole, "random", count, SEED)[0]
    size = file_bytes(first)
    for by in methods:
        points = first if by == "random" else at_bytes(case.whole, by, size, count)
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
    "localisation": (
        "Localisation in reduced maps",
        ["map", "points", "kB", "MB/km", "bits/point", "mm", "degrees", "lost", "2 %: mm", "2 %: degrees", "2 %: lost"],
    ),
    "size": ("Positions of maps", ["map", "points", "ours", "Draco", "LASzip", "PCD", "under Draco", "under LASzip"]),
}
"""Title and columns of each table, by the name of its result."""
PLAIN: Final = ("voxel", "random")


def order_of(label: str) -> tuple[int, float, int]:
    """Rows are ordered by drive, then by share, the largest first, then by method."""
    drive, share, _, by = label.split()
    return list(DRIVES).index(drive), -float(share), ["whole", *METHODS].index(by)


def verdict(rows: list[list[str]]) -> str:
    """What the table of localisation says, in sentences: where a plain choice of points is the best one."""
    cells = {row[0]: (int(row[7].split()[0]), float(row[5].split()[0]) if row[5] != "-" else np.inf) for row in rows}
    shares = dict.fromkeys(name.rpartition(" ")[0] for name in cells if not name.endswith("whole"))
    beaten, near, whole_kept = [], 0, 0
    for share in shares:
        found = {by: cells[f"{share} {by}"] for by in METHODS if f"{share} {by}" in cells}
        best = min(found, key=lambda by: found[by])
        whole = cells[f"{share.split()[0]} 100 % whole"]
        if best in PLAIN:
            beaten.append(f"{share} {best}")
        near += found[best][1] <= 1.5 * whole[1]
        whole_kept += found[best][0] <= whole[0]
    first = (
        f"A plain choice, `voxel` or `random`, finds whole scans best in {len(beaten)} of {len(shares)} cases, by lost "
        f"steps, then by mean error{': ' * bool(beaten)}{', '.join(beaten)}."
    )
    return (
        f"{first} With the best choice no step is lost that the whole map keeps in {whole_kept} of {len(shares)} "
        f"cases, and the error is within 1.5 times that of the whole map in {near}. All maps of a share have the same "
        "bytes. Poses of KITTI are refined from the same scans."
    )


def put(name: str, row: list[str]) -> None:
    """Put a row into a result file, in the place of the one with its name."""
    title, columns = TABLES[name]
    try:
        before = results.read(f"maps/{name}")
        rows = {one[0]: one for one in before.rows} if before.columns == columns else {}
    except FileNotFoundError:
        rows = {}
    ordered = sorted(({**rows, row[0]: row}).values(), key=lambda one: order_of(one[0]))
    about = {"about": verdict(ordered)} if name == "localisation" else {}
    results.write(f"maps/{name}", results.Result(results.here() | {"title": title} | about, columns, ordered))


def main() -> None:
    """Print, and with --save write, both tables."""
    words = argparse.ArgumentParser(description=__doc__)
    words.add_argument("--drives", default=",".join(DRIVES))
    words.add_argument("--methods", default=",".join(METHODS))
    words.add_argument("--tables", default=",".join(TABLES))
    words.add_argument("--cache", type=Path, default=Path("build/maps"))
    words.add_argument("--save", action="store_true")
    asked = words.parse_args()
    methods = asked.methods.split(",")
    cases = [case_of(drive, asked.cache) for drive in asked.drives.split(",")]
    parts: list[tuple[str, Callable[[Case], Iterator[list[str]]]]] = [("localisation", whole_rows)]
    parts += [("localisation", partial(share_rows, share=share, methods=methods)) for share in SHARES]
    parts.append(("size", peer_rows))
    for (name, make), case in product(parts, cases):
        if name in asked.tables.split(","):
            for row in make(case):
                print(*row, sep="  ", flush=True)
                if asked.save:
                    put(name, row)


if __name__ == "__main__":
    main()

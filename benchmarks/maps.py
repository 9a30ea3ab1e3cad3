"""Maps for localisation: how well scans are found in reduced maps, and how small their files are.

    python -m benchmarks.maps --cache DIR [--drives road,0013] [--weights FILE] [--jobs 2] --save

The map of a drive is of the scans that are not looked for. Every third scan is looked for, from the last estimate, as
`evaluate localisation --map FILE` does: means of 0.5 m cells of the whole scan, and 2 % of its returns. Poses are exact
for simulated drives, otherwise refined from the scans. Both are kept in DIR. All maps of a share have the bytes of the
random one, to about a percent. Peers code the very points of a map, on its grid. With `--weights` the network of
`train map-points` is a method, too. With `--save` each row takes the place of the row of its name in the result files.
"""

from __future__ import annotations

import argparse
import io
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from functools import lru_cache
from itertools import product
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Final

import numpy as np

from benchmarks import results
from benchmarks.map_cases import DRIVES, SEED, Case, case_of
from lidarcodec.maps.compress import bare, compressed, file_bytes
from lidarcodec.maps.localise.accuracy import SCANS, accuracy
from lidarcodec.maps.points import MapPoints
from lidarcodec.maps.select.table import LEARNED, method
from lidarcodec.maps.world import MapWorld

SHARES: Final = (0.2, 0.15, 0.1, 0.05, 0.02)
METHODS: Final = ("random", "voxel", "lp", "paper", "greedy", "information", LEARNED)
ROUNDS: Final = 4
Row = list[str]
Rows = Iterator[tuple[str, Row]]
"""Rows, each with the name of its table."""


@lru_cache(maxsize=1)
def _case(name: str, cache: Path) -> Case:
    return case_of(name, cache)


def at_bytes(points: MapPoints, by: str, size: int, count: int, weights: Path | None) -> tuple[MapPoints, Any]:
    """A map by a method with a file of about `size` bytes, and what is known of the choice; count: number of points to
    begin with."""
    select = method(by, weights if by == LEARNED else None)
    made, about = compressed(points, by, count, SEED, select)
    for _ in range(ROUNDS):
        bytes_ = file_bytes(made)
        if abs(bytes_ / size - 1) < 0.01:
            break
        count = min(max(round(count * size / bytes_), 100), len(points))
        made, about = compressed(points, by, count, SEED, select)
    return made, about


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


def row_of(case: Case, share: str, by: str, points: MapPoints) -> Row:
    """A row of the table of localisation."""
    size = file_bytes(points)
    return [
        f"{case.name} {share} {by}", f"{len(points):,}", f"{size / 1000:,.1f}",
        f"{size / 1000 / case.whole.length_m:.3f}", f"{8 * size / len(points):.1f}", *localised(case, points),
    ]  # fmt: skip


def case_made(name: str, cache: Path) -> Rows:
    """No row: the drive is made and kept."""
    _case(name, cache)
    return iter(())


def whole_rows(name: str, cache: Path) -> Rows:
    """A row for the whole map."""
    case = _case(name, cache)
    yield "localisation", row_of(case, "100 %", "whole", bare(case.whole))


def share_rows(name: str, cache: Path, share: float, by: str, weights: Path | None) -> Rows:
    """A row for a share and a method, with the bytes of the random choice, and one for the gap of the programme."""
    case = _case(name, cache)
    count = int(share * len(case.whole))
    points = compressed(case.whole, "random", count, SEED)[0]
    if by != "random":
        points, about = at_bytes(case.whole, by, file_bytes(points), count, weights)
    yield "localisation", row_of(case, f"{100 * share:g} %", by, points)
    if by == "paper":
        head = [f"{name} {100 * share:g} % paper", f"{len(points):,}", f"{about['b']:.1f}"]
        yield "programme", [*head, f"{100 * about['gap']:.3f} %"]


def peer_rows(name: str, cache: Path) -> Rows:
    """Bits a point of positions alone, of the whole map and of the greedy and random ones."""
    case = _case(name, cache)
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
            yield (
                "size",
                [
                    f"{case.name} {100 * share:g} % {'whole' if share == 1 else by}",
                    f"{len(only):,}",
                    *(f"{8 * size / len(only):.2f}" for size in sizes.values()),
                    *(f"{100 * (1 - ours / sizes[peer]):.1f} %" for peer in ("Draco", "LASzip")),
                ],
            )


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
    "programme": ("How near `paper` is to the best choice of its programme", ["map", "points", "b", "gap"]),
    "size": ("Positions of maps", ["map", "points", "ours", "Draco", "LASzip", "PCD", "under Draco", "under LASzip"]),
}
"""Title and columns of each table, by the name of its result."""
PLAIN: Final = ("voxel", "random")
TIMES: Final = 1.5
"""How much larger than with the whole map an error may be."""


def order_of(label: str) -> tuple[int, float, int]:
    """Rows are ordered by drive, then by share, the largest first, then by method."""
    drive, share, _, by = label.split()
    return list(DRIVES).index(drive), -float(share), ["whole", *METHODS].index(by)


def error_of(row: list[str]) -> tuple[float, float]:
    """Mean error of whole scans in millimetres, and its standard error; infinite where no scan was found."""
    if row[5] == "-":
        return np.inf, 0.0
    mean, _, error = row[5].split()
    return float(mean), float(error)


def best_of(methods: dict[str, list[str]]) -> str:
    """The method that loses the fewest scans, and of those the one with the smallest error."""
    return min(methods, key=lambda by: (int(methods[by][7].split()[0]), error_of(methods[by])[0]))


def verdict(rows: list[list[str]]) -> str:
    """What the table of localisation says, in sentences: where a plain choice of points is the best one."""
    of = {row[0]: row for row in rows}
    shares = dict.fromkeys(name.rpartition(" ")[0] for name in of if not name.endswith("whole"))
    beaten = near = whole_kept = 0
    for share in shares:
        found = {by: of[f"{share} {by}"] for by in METHODS if f"{share} {by}" in of}
        best = best_of(found)
        whole = of[f"{share.split()[0]} 100 % whole"]
        beaten += best in PLAIN
        near += error_of(found[best])[0] <= TIMES * error_of(whole)[0]
        whole_kept += int(found[best][7].split()[0]) <= int(whole[7].split()[0])
    return (
        f"A plain choice, `voxel` or `random`, is best in {beaten} of {len(shares)} cases, by lost scans, then by mean "
        f"error. With the best choice no more scans are lost than in the whole map in {whole_kept} cases. The error is "
        f"within 1.5 times that of the whole map in {near}. All maps of a share have the same bytes. Poses of KITTI "
        "are refined from the same scans."
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


def made(make: Callable[..., Rows], *given: Any) -> list[tuple[str, Row]]:
    """All rows of a job, in a process of its own."""
    return list(make(*given))


def jobs_of(
    drives: Sequence[str], tables: Sequence[str], methods: Sequence[str], asked: argparse.Namespace
) -> list[Any]:
    """What is to be measured: functions with their arguments, drive by drive."""
    jobs: list[Any] = []
    for name in drives:
        if "localisation" in tables:
            jobs.append((whole_rows, name, asked.cache))
            jobs += [(share_rows, name, asked.cache, *one, asked.weights) for one in product(SHARES, methods)]
        if "size" in tables:
            jobs.append((peer_rows, name, asked.cache))
    return jobs


def main() -> None:
    """Print, and with --save write the tables."""
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    words.add_argument("--drives", default=",".join(DRIVES))
    words.add_argument("--methods", help="default: all, `learned` with --weights only")
    words.add_argument("--tables", default="localisation,size")
    words.add_argument("--weights", type=Path, help="of `lidarcodec train map-points`")
    words.add_argument("--cache", type=Path, default=Path("build/maps"))
    words.add_argument("--jobs", type=int, default=1, help="processes")
    words.add_argument("--save", action="store_true")
    asked = words.parse_args()
    drives, tables = asked.drives.split(","), asked.tables.split(",")
    methods = asked.methods.split(",") if asked.methods else METHODS[: None if asked.weights else -1]
    with ProcessPoolExecutor(asked.jobs, mp_context=get_context("spawn")) as pool:
        for ready in as_completed([pool.submit(made, case_made, name, asked.cache) for name in drives]):
            ready.result()
        running = [pool.submit(made, *job) for job in jobs_of(drives, tables, methods, asked)]
        for ready in as_completed(running):
            for name, row in ready.result():
                print(name, *row, sep="  ", flush=True)
                if asked.save:
                    put(name, row)


if __name__ == "__main__":
    main()

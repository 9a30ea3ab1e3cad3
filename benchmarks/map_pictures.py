"""Short tables and a picture of what `benchmarks.maps` measured: errors and lost scans of every choice of points.

python -m benchmarks.map_pictures
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np

from benchmarks import results
from benchmarks.map_cases import DRIVES
from benchmarks.maps import METHODS, TIMES, best_of, error_of, verdict
from lidarcodec.evaluation.plots import blank_figure, plain_ticks

COLOURS: Final = {"random": "#94a3b8", "voxel": "#f59e0b", "lp": "#0891b2", "paper": "#2563eb", "greedy": "#16a34a",
                  "information": "#7c3aed", "learned": "#dc2626"}  # fmt: skip
PICTURE: Final = Path(__file__).resolve().parents[1] / "docs" / "maps.png"
KINDS: Final = {"choices": ("whole scans", 5, 7), "choices-thin": ("2 % of each scan", 8, 10)}
"""Table, which scans, and the columns of their error and of what was lost."""
CELLS: Final = "Mean error in millimetres, and how many scans were lost. `learned` was measured on two drives."
ABOVE: Final = (
    "Millimetres, whole scans. The best choice loses the fewest scans, then has the smallest error. A case that "
    "is less than two standard errors above 1.5 times may be there by chance."
)


def by_map(rows: list[list[str]]) -> dict[tuple[str, str], dict[str, list[str]]]:
    """Rows by drive and share, then by method."""
    found: dict[tuple[str, str], dict[str, list[str]]] = {}
    for row in rows:
        drive, share, _, by = row[0].split()
        found.setdefault((drive, share), {})[by] = row
    return found


def cell(row: list[str] | None, error: int, lost: int) -> str:
    """Error in millimetres, and how many scans were lost."""
    if row is None:
        return "-"
    gone = row[lost].split()[0]
    return row[error].split()[0] + (f" ({gone} lost)" if gone != "0" else "")


def choices(rows: list[list[str]], error: int, lost: int) -> Iterator[list[str]]:
    """A row for each drive and share, with a cell for each method, and one for the whole map."""
    found = by_map(rows)
    for (drive, share), methods in found.items():
        if "whole" not in methods:
            whole = found[drive, "100"]["whole"]
            cells = [cell(methods.get(by), error, lost) for by in METHODS]
            yield [f"{drive} {share} %", methods["random"][3], cell(whole, error, lost), *cells]


def totals(rows: list[list[str]]) -> Iterator[list[str]]:
    """A row for each method that was measured everywhere: how many scans it lost in all, beside the whole map, and in
    how many cases it lost no more than that, and had at most 1.5 times its error."""
    found = by_map(rows)
    cases = [(found[drive, "100"]["whole"], methods) for (drive, share), methods in found.items() if share != "100"]
    lost = [int(whole[7].split()[0]) for whole, _ in cases]
    for by in METHODS:
        if not all(by in methods for _, methods in cases):
            continue
        own = [int(methods[by][7].split()[0]) for _, methods in cases]
        near = [error_of(methods[by])[0] <= TIMES * error_of(whole)[0] for whole, methods in cases]
        kept = sum(one <= whole for one, whole in zip(own, lost, strict=True))
        yield [by, f"{sum(own)} ({sum(lost)})", f"{kept} of {len(cases)}", f"{sum(near)} of {len(cases)}"]


def beyond(rows: list[list[str]]) -> Iterator[list[str]]:
    """A row for each case in which the best choice has more than 1.5 times the error of the whole map: both errors,
    and by how many standard errors of the difference it is more."""
    found = by_map(rows)
    for (drive, share), methods in found.items():
        whole = found[drive, "100"]["whole"]
        best = best_of(methods)
        (mean, deviation), (least, own) = error_of(methods[best]), error_of(whole)
        if share != "100" and mean > TIMES * least:
            above = (mean - TIMES * least) / np.hypot(deviation, TIMES * own)
            cells = [cell_with_error(one) for one in (whole, methods[best], methods["greedy"])]
            yield [f"{drive} {share} %", cells[0], best, cells[1], f"{mean / least:.2f}", f"{above:.1f}", cells[2]]


def cell_with_error(row: list[str]) -> str:
    """Error in millimetres with its standard error, and how many scans were lost."""
    gone = row[7].split()[0]
    return row[5] + (f" ({gone} lost)" if gone != "0" else "")


def gaps(rows: list[list[str]]) -> list[list[str]]:
    """A row for each drive: the gap at each share."""
    found: dict[str, list[str]] = {}
    for row in rows:
        found.setdefault(row[0].split()[0], []).append(row[3])
    return [[drive, *cells] for drive, cells in found.items()]


def draw(rows: list[list[str]]) -> None:
    """Share of the scans that were lost, and mean error, against the size of the map, for each drive."""
    found = by_map(rows)
    figure = blank_figure(13, 14)
    grid = figure.subplots(len(DRIVES), 2, squeeze=False)
    for (left, right), drive in zip(grid, DRIVES, strict=True):
        whole = found[drive, "100"]["whole"]
        of = int(whole[7].split()[2])
        left.axhline(100 * int(whole[7].split()[0]) / of, color="black", linewidth=0.8, label="whole map")
        right.axhline(float(whole[5].split()[0]), color="black", linewidth=0.8)
        for by in METHODS:
            own = [methods[by] for (name, _), methods in found.items() if name == drive and by in methods]
            sizes = [float(row[3]) for row in own]
            left.plot(
                sizes,
                [100 * int(row[7].split()[0]) / of for row in own],
                "o-",
                color=COLOURS[by],
                label=by,
                markersize=3,
            )
            errors = [(size, float(row[5].split()[0])) for size, row in zip(sizes, own, strict=True) if row[5] != "-"]
            right.plot(*zip(*errors, strict=True), "o-", color=COLOURS[by], markersize=3)
        left.set_ylabel(f"{drive}: lost, %")
        right.set_ylabel("mm")
        right.set_yscale("log")
        plain_ticks(right.yaxis)
        for axes in (left, right):
            axes.set_xscale("log")
            plain_ticks(axes.xaxis)
            axes.grid(alpha=0.3, which="both", linewidth=0.5)
    grid[0][0].legend(frameon=False, fontsize=7, ncols=2)
    for axes in grid[-1]:
        axes.set_xlabel("MB/km")
    figure.savefig(PICTURE, dpi=80)


def main() -> None:
    """Write the tables and the picture."""
    measured, programme = results.read("maps/localisation"), results.read("maps/programme")
    for name, (scans, error, lost) in KINDS.items():
        head = measured.fields | {"title": f"Error by choice of points, {scans}", "about": CELLS}
        columns = ["map", "MB/km", "whole map", *METHODS]
        results.write(f"maps/{name}", results.Result(head, columns, list(choices(measured.rows, error, lost))))
    columns = ["choice", "lost (whole map)", "no more lost than the whole map", "error within 1.5 times"]
    about = verdict(measured.rows)
    head = measured.fields | {"title": "Choices of points over all drives and shares, whole scans", "about": about}
    results.write("maps/totals", results.Result(head, columns, list(totals(measured.rows))))
    head = measured.fields | {
        "title": "Where the best choice has more than 1.5 times the whole map's error",
        "about": ABOVE,
    }
    columns = ["map", "whole map", "best choice", "its error", "times", "standard errors above 1.5 times", "greedy"]
    results.write("maps/beyond", results.Result(head, columns, list(beyond(measured.rows))))
    shares = list(dict.fromkeys(row[0].split()[1] for row in programme.rows))
    columns = ["drive", *(f"{share} %" for share in shares)]
    results.write("maps/gaps", results.Result(programme.fields, columns, gaps(programme.rows)))
    draw(measured.rows)


if __name__ == "__main__":
    main()

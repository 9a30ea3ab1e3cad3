"""How near `learned` comes to the integer programme, as the figures of map compression (Zhang et al.) show it.

    python -m benchmarks.likeness --cache DIR [--epochs 16] [--threads 1] --save

A network learns what the programme keeps of the half of a map where its drive began, at 20 % of the points. It is then
applied to the other half, to another simulated town and to KITTI 0013, and keeps the points with the highest scores, as
many as the programme. From each of them it is measured how far the nearest point is that the programme keeps. A dense
choice is near everything, so other choices of the same count are measured as well. The last tenth of the first half
decides which epoch is taken. Maps and the checkpoint are kept in DIR (as by `benchmarks.maps`).
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from benchmarks import results
from benchmarks.map_cases import SEED, case_of
from lidarcodec.evaluation.plots import blank_figure
from lidarcodec.maps.points import MapPoints
from lidarcodec.maps.select.greedy import greedy
from lidarcodec.maps.select.labels import labelled, nearest_m
from lidarcodec.maps.select.learned import learned_by
from lidarcodec.maps.select.plain import random_points, voxel
from lidarcodec.maps.select.point_net import LAYERS, Layer, PointNet
from lidarcodec.maps.select.programme import paper
from lidarcodec.maps.select.windows import halves
from lidarcodec.training import training_module

LEARNT_OF: Final = "city"
SHARE: Final = 0.2
SHARES: Final = (0.2, 0.15, 0.1, 0.05)
BATCH: Final = 4
NEAR_M: Final = 0.1
BINS_M: Final = np.arange(0.0, 1.01, 0.1)
COLOURS: Final = {"learned": "#dc2626", "random": "#94a3b8", "voxel": "#f59e0b", "greedy": "#16a34a"}
PICTURE: Final = Path(__file__).resolve().parents[1] / "docs" / "likeness.png"
Distances = dict[str, npt.NDArray[np.float64]]
Select = Callable[[MapPoints, int], MapPoints]


def trained(first: MapPoints, cache: Path, epochs: int, threads: int) -> tuple[PointNet, str]:
    """A network of a half of a map, and a sentence about its training. A checkpoint in the folder is continued."""
    training, runs = training_module("train_map_points"), training_module("runs")
    runs.limit_threads(threads)
    points, kept = labelled(first, SHARE, SEED).windows()
    learnt = len(points) - max(len(points) // 10, 1)
    run = training.PointsRun(seed=SEED, epochs=epochs, batch=BATCH)
    out, spent = cache / f"likeness-{epochs}.pt", cache / f"likeness-{epochs}.seconds"
    before, began = float(spent.read_text()) if spent.exists() else 0.0, time.process_time()

    def tick() -> None:
        spent.write_text(f"{before + time.process_time() - began:.0f}")
        print(runs.load_checkpoint(out).log[-1], spent.read_text(), "s", flush=True)

    windows = training.Windows(points[:learnt], kept[:learnt]), training.Windows(points[learnt:], kept[learnt:])
    net = training.train_map_points(LAYERS, *windows, out, run, "cpu", tick)
    log = runs.load_checkpoint(out).log
    lowest = min(log, key=lambda one: one["held_out"])
    share = kept[learnt:].mean()
    guess = -(share * np.log(share) + (1 - share) * np.log(1 - share))
    about = (
        f"The network was trained for {epochs} epochs of {learnt} windows, {spent.read_text()} processor seconds. Its "
        f"cross entropy on the {len(points) - learnt} windows left out was {lowest['held_out']:.3f} at best, in epoch "
        f"{lowest['epoch']}; their share of kept points alone gives {guess:.3f}."
    )
    return PointNet({name: Layer(*layer) for name, layer in net.folded().items()}, {}), about


def maps(cache: Path) -> tuple[MapPoints, dict[str, MapPoints]]:
    """The half of a map that is learnt from, and the maps that the network is applied to."""
    first, second = halves(case_of(LEARNT_OF, cache).whole)
    return first, {
        f"{LEARNT_OF}, other half": second,
        "another town": case_of("city-2", cache).whole,
        "KITTI 0013": case_of("0013", cache).whole,
    }


def distances(points: MapPoints, share: float, learned: Select) -> Distances:
    """Of each choice: metres from each of its points to the nearest point of the programme."""
    count = round(share * len(points))
    truth = paper(points, count, SEED).points
    choices = {
        "learned": learned(points, count),
        "random": random_points(points, count, SEED).points,
        "voxel": voxel(points, count, SEED).points,
        "greedy": greedy(points, count, SEED).points,
    }
    return {name: nearest_m(chosen, truth) for name, chosen in choices.items()}


def row(name: str, share: float, found: Distances) -> list[str]:
    """A row: of each choice the share that is near, and the mean distance."""
    return [f"{name}, {100 * share:g} %"] + [
        f"{100 * (found[choice] < NEAR_M).mean():.0f} % ({found[choice].mean():.2f})" for choice in COLOURS
    ]


def draw(found: dict[tuple[str, float], Distances]) -> None:
    """Histograms of the distances, a row for each map, at the largest and at the smallest share."""
    names, shares = list(dict.fromkeys(name for name, _ in found)), (SHARES[0], SHARES[-1])
    figure = blank_figure(11, 3 * len(names))
    for line, name in zip(figure.subplots(len(names), 2, squeeze=False), names, strict=True):
        for axes, share in zip(line, shares, strict=True):
            for choice, colour in COLOURS.items():
                _steps(axes, found[name, share][choice], choice, colour)
            axes.set_title(f"{name}, {100 * share:g} % kept", fontsize=9)
            axes.set_ylabel("% of the points")
            axes.grid(alpha=0.3, linewidth=0.5)
            axes.set_xlabel("metres to the programme's nearest point; at the right: all beyond", fontsize=8)
        line[0].legend(frameon=False, fontsize=8)
    figure.savefig(PICTURE, dpi=80)


def _steps(axes: object, metres: npt.NDArray[np.float64], label: str, colour: str) -> None:
    counts, _ = np.histogram(np.minimum(metres, BINS_M[-1] - 1e-9), BINS_M)
    width = 2.2 if label == "learned" else 1.2
    axes.stairs(100 * counts / len(metres), BINS_M, label=label, color=colour, linewidth=width)  # type: ignore[attr-defined]


def measured(cache: Path, net: PointNet) -> Iterator[tuple[str, float, Distances]]:
    """Distances of all maps and shares."""
    select = learned_by(net)
    for name, points in maps(cache)[1].items():
        for share in SHARES:
            yield name, share, distances(points, share, lambda given, count: select(given, count, SEED).points)


def main() -> None:
    """Print, and with --save write the table and draw the picture."""
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    words.add_argument("--cache", type=Path, default=Path("build/maps"))
    words.add_argument("--epochs", type=int, default=16)
    words.add_argument("--threads", type=int, default=1)
    words.add_argument("--save", action="store_true")
    asked = words.parse_args()
    net, about = trained(maps(asked.cache)[0], asked.cache, asked.epochs, asked.threads)
    print(about, flush=True)
    rows, found = [], {}
    for name, share, one in measured(asked.cache, net):
        found[name, share] = one
        rows.append(row(name, share, one))
        print(*rows[-1], sep="  ", flush=True)
    if asked.save:
        head = results.here() | {"title": "Points by several choices that lie near one of the integer programme"}
        about = f"Share within {NEAR_M:g} m of a point that the programme keeps, and mean distance in metres. {about}"
        results.write("maps/likeness", results.Result(head | {"about": about}, ["map, share", *COLOURS], rows))
        draw(found)


if __name__ == "__main__":
    main()

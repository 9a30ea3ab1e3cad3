"""Prints, as Markdown, what the network of `poconet` says of drives and captures for which there are no labels.

    python -m benchmarks.scored movers vlp16 os1-128 ...    # simulated: what it leaves out of vehicles, and of all else
    python -m benchmarks.scored captures FILE ...           # real: whether it agrees with other ways to find the ground

Ground is compared by IoU over returns beyond 3 m, with what `annotate` finds (RANSAC), and that with what `voxel-seen`
finds. Of a capture the frame with the most returns is taken.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from lidarcodec.api import read_frames
from lidarcodec.frame import Frame
from lidarcodec.reduction.ground import ground_of
from lidarcodec.reduction.poconet import NEAR_M, SELDOM
from lidarcodec.reduction.score_network import Scores, scores_of
from lidarcodec.reduction.spread import LENGTHS_PER_M, returns_of
from lidarcodec.sources import open_source
from lidarcodec.sources.simulator import LABELS, SimulatorSource
from lidarcodec.sources.spinning.source import SpinningSource
from lidarcodec.sources.spinning.table import Wanted
from lidarcodec.training.ground import Ransac

SCENES: Final = {"road": (9201, 9202, 9203), "street": (9101, 9102), "city": (9001, 9002), "motorway": (9301, 9302)}
"""Seeds that the network was not trained on."""
SKIP: Final = 30
OWN_M: Final = 3.0
"""Nearer is the vehicle itself."""
Bools = npt.NDArray[np.bool_]


def scored(frame: Frame) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.uint32], Scores, Bools]:
    """Points in metres, cells, scores, and whether each return is left out."""
    returns = returns_of(frame)
    scores, points = scores_of(frame, returns), returns.xyz / LENGTHS_PER_M
    near = np.linalg.norm(points, axis=1) < NEAR_M
    return points, returns.cells, scores, (scores.seldom > SELDOM) & near & ~scores.is_ground


def simulated(sensor: str, scene: str, seed: int) -> tuple[Frame, npt.NDArray[np.uint8]]:
    """A frame, and what each of its cells is of."""
    if sensor == "hdl64e":
        with SimulatorSource(scene, seed=seed, frames=1, skip=SKIP) as source:
            frame = next(iter(read_frames(source)))
            assert frame.side is not None
            return frame, source.truth(frame.side.packets)[2].T[frame.sensor.laser_of_ring]
    with SpinningSource(Wanted(sensor), scene, seed=seed, frames=1, skip=SKIP) as source:
        frame = next(iter(read_frames(source)))
        assert frame.side is not None
        return frame, source.truth(frame.side.packets).labels


def movers(sensors: Sequence[str]) -> None:
    """Shares of the returns of vehicles from 3 to 40 m, and of all others, that are left out."""
    print("| sensor | " + " | ".join(f"{scene}: vehicles, others" for scene in SCENES) + " |")
    print("|---|" + "---|" * len(SCENES))
    for sensor in sensors:
        cells = []
        for scene, seeds in SCENES.items():
            out, of = np.zeros(2), np.zeros(2)
            for seed in seeds:
                frame, labels = simulated(sensor, scene, seed)
                points, places, _, dropped = scored(frame)
                away = np.linalg.norm(points, axis=1)
                vehicle = (labels.ravel()[places] == LABELS.index("vehicle")) & (away < NEAR_M)
                for k, kind in enumerate((vehicle, ~vehicle)):
                    of[k] += (kind & (away > OWN_M)).sum()
                    out[k] += (kind & (away > OWN_M) & dropped).sum()
            cells.append(", ".join(f"{share:.1%}" for share in out / np.maximum(of, 1)))
        print(f"| {sensor} | {' | '.join(cells)} |", flush=True)


def captures(files: Sequence[str]) -> None:
    """Agreement on the ground, and the share of returns that are left out."""
    print("| capture | sensor | returns | nearer than 3 m | network with RANSAC | RANSAC with sectors | left out |")
    print("|---|---|---:|---:|---:|---:|---:|")
    for file in files:
        with open_source(file) as source:
            frame = max(read_frames(source), key=lambda frame: frame.points)
        points, _, scores, dropped = scored(frame)
        beyond = np.linalg.norm(points, axis=1) > OWN_M
        plane, sectors = Ransac().ground(points), ground_of(points.astype(np.float32)) > 0
        cells = [file.rpartition("/")[2], frame.sensor.model, f"{frame.points:,}", f"{np.mean(~beyond):.0%}"]
        cells += [f"{iou(one[beyond], plane[beyond]):.2f}" for one in (scores.is_ground, sectors)]
        print(f"| {' | '.join(cells)} | {np.mean(dropped):.1%} |", flush=True)


def iou(one: Bools, other: Bools) -> float:
    """Intersection over union."""
    return float((one & other).sum() / max((one | other).sum(), 1))


if __name__ == "__main__":
    if len(sys.argv) < 3 or sys.argv[1] not in ("movers", "captures"):
        sys.exit(__doc__)
    (movers if sys.argv[1] == "movers" else captures)(sys.argv[2:])

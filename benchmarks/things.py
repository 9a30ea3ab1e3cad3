"""How much of the things around a sensor is sent: cars, people, poles and the like of a simulated town.

    python -m benchmarks.things [--write]

measures it for points of a grid of columns and bounds, in towns for training, which is what the operating curves of the
purpose `detect` are made of; with --write it goes to lidarcodec/ratecontrol/working_points_detect.json.

A simulated drive says what each return lies on. Returns on one kind of thing whose squares of 0.5 m touch are a thing.
Of each thing that is nearer than 50 m and has five returns or more: the mean distance from its returns to the nearest
that was sent, at most 1 m. Things count alike, however many returns they have, and near ones more, by
1 / (1 + (d / 20 m)^2).
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Sequence
from itertools import product
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from benchmarks.scenes import FRAMING
from benchmarks.working_points import BOUNDS_M, STEPS, coded, table_text
from lidarcodec.evaluation.geometry import Cloud, xyz_of
from lidarcodec.frame import Frame
from lidarcodec.packet import Packet
from lidarcodec.pipeline import frames_of
from lidarcodec.settings import StreamSettings
from lidarcodec.sources.simulator import LABELS, SimulatorSource
from lidarcodec.units import FRAME_PACKETS, PACKET_INTERVAL_US

OUT: Final = Path(__file__).parents[1] / "lidarcodec/ratecontrol/working_points_detect.json"
TOWNS: Final = (
    "sim:city?seed=3&skip=20&packets=100000",
    "sim:city?seed=5&skip=60&packets=100000",
    "sim:city?seed=7&skip=40&packets=100000",
    "sim:street?seed=4&skip=10&packets=100000",
)
FRAMES: Final = 3
KINDS: Final = ("vehicle", "person", "pole", "other")
SQUARE_M: Final = 0.5
FAR_M: Final = 50.0
FEWEST: Final = 5
MOST_M: Final = 1.0
NEAR_M: Final = 20.0

Points = npt.NDArray[np.float64]


class Thing(NamedTuple):
    """points: (N, 3) metres;  weight: by how near it is"""

    points: Points
    weight: float


def frames_with_things(spec: str, count: int) -> list[tuple[Frame, list[Thing]]]:
    """Frames of a simulated drive, each with the things in it."""
    source = SimulatorSource.from_spec(spec)
    payloads, _, labels = source.truth(FRAME_PACKETS * count)
    stamps = source.start_ns + 1000 * PACKET_INTERVAL_US * np.arange(len(payloads))
    packets = [Packet(data.tobytes(), int(stamp)) for data, stamp in zip(payloads, stamps, strict=True)]
    found, first = [], 0
    for frame in frames_of(packets, source.sensor, FRAMING):
        of_frame = labels[first : first + frame.width, frame.sensor.laser_of_ring].T
        first += frame.width
        found.append((frame, things_in(frame, of_frame)))
    return found


def things_in(frame: Frame, labels: npt.NDArray[np.uint8]) -> list[Thing]:
    """The things of a frame. labels: (64, W), indices into LABELS."""
    points = xyz_of(frame.cloud()).astype(np.float64)
    of_point = labels.T[frame.valid.T]
    found = []
    for kind in KINDS:
        of_kind = points[of_point == LABELS.index(kind)]
        for places in _touching(np.floor(of_kind[:, :2] / SQUARE_M).astype(np.int64)):
            thing = of_kind[places]
            far_m = float(np.hypot(thing[:, 0], thing[:, 1]).mean())
            if len(thing) >= FEWEST and far_m < FAR_M:
                found.append(Thing(thing, 1.0 / (1.0 + (far_m / NEAR_M) ** 2)))
    return found


def missed_m(things: Sequence[Thing], sent: Frame) -> float:
    """Mean distance from what was there to what was sent, in metres. sent: as decoded, without what is made up"""
    points = xyz_of(sent.cloud()).astype(np.float64)
    if not len(points):
        return MOST_M
    cloud = Cloud(points)
    far = [
        np.minimum(np.linalg.norm(one.points - cloud.points[cloud.nearest(one.points)], axis=1), MOST_M).mean()
        for one in things
    ]
    return float(np.average(far, weights=[one.weight for one in things]))


def _touching(squares: npt.NDArray[np.int64]) -> list[list[int]]:
    """Places of points whose squares touch, group by group. squares: (N, 2)."""
    of_square = defaultdict(list)
    for place, square in enumerate(map(tuple, squares.tolist())):
        of_square[square].append(place)
    groups: list[list[int]] = []
    while of_square:
        square, places = of_square.popitem()
        groups.append(list(places))
        waiting = [square]
        while waiting:
            x, y = waiting.pop()
            for dx, dy in product((-1, 0, 1), repeat=2):
                if (x + dx, y + dy) in of_square:
                    groups[-1] += of_square.pop((x + dx, y + dy))
                    waiting.append((x + dx, y + dy))
    return groups


def grid() -> dict[str, Any]:
    """What is missed at each step of the lattice and each bound, (steps, bounds) metres, over all towns."""
    bounds = sorted(BOUNDS_M)
    towns = [frames_with_things(spec, FRAMES) for spec in TOWNS]
    missed = np.zeros((len(STEPS), len(bounds)))
    for (row, step), (column, bound_m) in product(enumerate(STEPS), enumerate(bounds)):
        settings = StreamSettings(codec="zstd", max_error_m=bound_m, intensity="off")
        found = []
        for town in towns:
            _, decoded = coded("zstd", step, settings, [frame for frame, _ in town])
            found += [missed_m(things, back) for (_, things), back in zip(town, decoded, strict=True)]
        missed[row, column] = np.mean(found)
    return {"steps": list(STEPS), "bounds_m": bounds, "missed_m": missed.round(5).tolist()}


def main() -> None:
    """Measure and print; with --write, keep."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", action="store_true", help="keep the result")
    args = parser.parse_args()
    text = table_text(grid())
    if args.write:
        OUT.write_text(text)
    else:
        print(text, end="")


if __name__ == "__main__":
    main()

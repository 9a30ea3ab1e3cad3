"""Prints, as Markdown, what a frame takes with each reducer: alone, and with a codec behind it, on one core.

    python -m benchmarks.reducers SOURCE [--calibration FILE] [--poses FILE] [--frames 48] [--codec predictive]
                                  [--reduction voxel,poconet] [--keep-points 9000] [--set max_error_m=0.01]

Times are processor time of all threads, so that none hides behind a second core, of each frame but the first ten, in
which a network is loaded and `voxel-seen` has nothing to look back at. `voxel-seen` with a source that has poses is
beside given odometry; `voxel-seen, found` is without them.
"""

from __future__ import annotations

import argparse
import sys
from itertools import islice
from pathlib import Path
from time import process_time

import numpy as np

from benchmarks.scenes import FRAMING
from lidarcodec.commands.settings import one_setting
from lidarcodec.frame import Frame
from lidarcodec.pipeline import StreamEncoder, frames_of
from lidarcodec.reduction import make_reducer, names, reduction
from lidarcodec.settings import StreamSettings
from lidarcodec.sources import open_source
from lidarcodec.sources.posed import with_poses
from lidarcodec.wire import pack

BUDGET_MS = {"voxel": 6, "voxel-seen": 20, "poconet": 40}
"""A reducer alone; `voxel-seen` beside given odometry."""
ARGUMENTS = {"columns": ":12", "lattice": ":12"}
WARM_UP = 10
Times = tuple[float, float]


def quantiles(seconds: list[float]) -> Times:
    """Milliseconds: the median, and what 99 of 100 frames stay below."""
    median, most = np.quantile(1e3 * np.array(seconds[WARM_UP:]), [0.5, 0.99])
    return float(median), float(most)


def alone(frames: list[Frame], settings: StreamSettings) -> Times:
    """Of the reducer. Raises AssertionError if it does not keep its budget: a time would mean nothing then."""
    reducer, seconds = make_reducer(settings), []
    for frame in frames:
        began = process_time()
        reduced = reducer.reduce(frame)
        seconds.append(process_time() - began)
        kept = int(reduced.valid.sum())
        assert settings.keep_points is None or kept == min(settings.keep_points, frame.points), f"{kept} returns kept"
    return quantiles(seconds)


def with_codec(frames: list[Frame], settings: StreamSettings) -> tuple[Times, float]:
    """Of reducer and codec, from a frame to the bytes of its messages; and kilobytes of a frame."""
    encoder, seconds, size = StreamEncoder(settings), [], 0
    for frame in frames:
        began = process_time()
        messages = [pack(message) for message in encoder.encode(frame)]
        seconds.append(process_time() - began)
        size += sum(map(len, messages))
    return quantiles(seconds), size / len(frames) / 1e3


def main() -> int:
    """Measure, and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("source")
    parser.add_argument("--calibration", type=Path)
    parser.add_argument("--poses", type=Path)
    parser.add_argument("--frames", type=int, default=48)
    parser.add_argument("--codec", default="predictive")
    parser.add_argument("--keep-points", type=int, default=9000)
    parser.add_argument("--reduction", default=",".join(name for name in names() if name != "auto"))
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    given = parser.parse_args()
    with open_source(given.source, calibration=given.calibration, poses=given.poses) as source:
        framing = FRAMING if source.sensor.is_hdl64e else "revolution"
        posed = with_poses(frames_of(source.packets(), source.sensor, framing), source.poses)
        read = list(islice(posed, given.frames + 2))
        usual = np.median([frame.points for frame in read]) if read else 0  # a capture begins and ends within a turn
        frames = [frame for frame in read if frame.points > usual / 2][: given.frames]
    if len(frames) <= 2 * WARM_UP:
        parser.error(f"{given.source} has {len(frames)} whole frames: more than {2 * WARM_UP} are needed")
    bare = [frame.with_(pose=None) for frame in frames]
    others = {"intensity": "off", "max_error_m": "0.01", **dict(item.split("=", 1) for item in given.set)}
    print(f"{given.source}: {np.mean([frame.points for frame in frames]):,.0f} returns a frame, codec {given.codec}\n")
    print("| reducer | median, ms | 99 %, ms | budget | with codec, median | 99 % | kB |")
    print("|---|---:|---:|---:|---:|---:|---:|")
    for name in given.reduction.split(","):
        budget = {"keep_points": str(given.keep_points)} if reduction(name).budgeted else {}
        asked = {"reduction": name + ARGUMENTS.get(name, ""), **others, **budget}
        settings = one_setting(given.codec, [f"{key}={value}" for key, value in asked.items()])
        runs = {name: frames}
        if name == "voxel-seen":
            runs = {**({name: frames} if frames[0].pose is not None else {}), f"{name}, found": bare}
        for label, used in runs.items():
            (median, most), ((both, both_most), kilobytes) = (
                alone(used, settings), with_codec(used, settings),
            )  # fmt: skip
            cells = [f"{median:.1f}", f"{most:.1f}", str(BUDGET_MS.get(label, "")), f"{both:.1f}", f"{both_most:.1f}"]
            print(f"| `{label}` | {' | '.join(cells)} | {kilobytes:.2f} |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())

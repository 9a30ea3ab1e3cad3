"""What few returns cost, and how well a car finds its place by them: the working points of the purpose `localise`.

    lidarcodec evaluate localisation "sim:road?seed=11&packets=58000" \\
        "sim:motorway?seed=12&packets=58000" "sim:bend?seed=13&packets=58000" --frames 162 \\
        --codec predictive --reduction voxel-seen --keep-points 1800,3000,5000,8500,15000 \\
        --set max_error_m=0.01,0.03,0.1 --protocol near --protocol track --json > errors.json
    python -m benchmarks.localise_points errors.json [--codecs riddle,pcodec] [--frames 1] [--coarse] [--write]

A working point is one return in so many, chosen by `voxel-seen`, a value of the codec's knob and a number of intensity
levels. For each codec it measures over training drives, in bits per return of the original frame: ranges (by step and
knob), intensity (by step and levels), and all else (by step). What a point is worth is how far off a car is, in metres,
that looks for its place from near: on three drives that docs/reduction.md does not have, as a plane through the
logarithms of returns and bound. With --write the table goes to lidarcodec/ratecontrol/working_points_localise.json, one
entry a codec; entries of other codecs stay. --coarse measures every second step and value of two drives: enough for
codecs that nobody takes for this.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any, Final

import numpy as np

from benchmarks.working_points import WARM, Floats, drives, sizes_of, table_text, values_of
from lidarcodec.codecs import table
from lidarcodec.frame import Frame
from lidarcodec.reduction.thinning import Thinning
from lidarcodec.settings import StreamSettings

OUT: Final = Path(__file__).parents[1] / "lidarcodec/ratecontrol/working_points_localise.json"
DRIVES: Final = (
    ("kitti_0013_f052-107.pcap.xz", 10),
    ("kitti_0001_f000-089.pcap.xz", 40),
    ("sim:road?seed=11&packets=13920", 20),
    ("sim:city?seed=3&packets=13920", 20),
)
STEPS: Final = (9, 13, 19, 28, 40, 60, 90)
"""More than one in nine are not taken, as more than 15,000 returns were not looked at: what moves is among the rest."""
BOUNDS_M: Final = (0.1, 0.065, 0.045, 0.03, 0.02, 0.01, 0.004)
QUALITIES: Final = (20, 50, 80, 95, 100)
CRFS: Final = (32, 24, 16, 8, 0)
LEVELS: Final = (0, 16, 256)
SHARP_M: Final = 0.1
RETURNS: Final = 110_000
"""Of a frame, where a step stands for a number of returns."""


def errors_plane(results: list[dict[str, Any]]) -> Floats:
    """(3,) of ln(error) = a + b ln(returns) + c ln(1 + (bound / 10 cm)^2), fitted to the means of drives."""
    rows = [one for one in results if not one["source"].endswith(" drives")]
    names = sorted({(one["keep_points"], one["settings"]["max_error_m"]) for one in rows})
    left, right = [], []
    for points, bound in names:
        same = [r for r in rows if (r["keep_points"], r["settings"]["max_error_m"]) == (points, bound)]
        left.append(_terms(points, bound))
        right.append(np.log(np.mean([one["near"]["mate_m"] for one in same])))
        print(points, bound, "near, m", round(float(np.exp(right[-1])), 4), "lost",
              sum(one["track"]["lost"] for one in same), "kbit/s", round(np.mean([one["kbps"] for one in same])),
              file=sys.stderr)  # fmt: skip
    plane: Floats = np.linalg.lstsq(np.array(left), np.array(right), rcond=None)[0]
    print("plane", plane.round(3).tolist(), file=sys.stderr)
    return plane


def _terms(returns: float, bound_m: float) -> list[float]:
    return [1.0, float(np.log(returns)), float(np.log1p((bound_m / SHARP_M) ** 2))]


def measured(codec: str, sets: list[list[Frame]], plane: Floats, *, coarse: bool) -> dict[str, Any]:
    """The codec's entry. plane: what points are worth, of `errors_plane`; coarse: every second step and value"""
    steps = STEPS[::2] if coarse else STEPS
    values = values_of(codec, BOUNDS_M, QUALITIES, CRFS)[:: 2 if coarse else 1]
    knob, bounded = table.codec(codec).knob, table.codec(codec).bounded
    assert knob is not None
    points = sum(frame.points for frames in sets for frame in frames[WARM:])
    ranges, worth, rmse = (np.zeros((len(steps), len(values))) for _ in range(3))
    rest, levels_bits = np.zeros(len(steps)), np.zeros((len(steps), len(LEVELS)))
    for at, step in enumerate(steps):
        thinned = []
        for frames in sets:
            thinning = Thinning(StreamSettings(purpose="localise"))
            thinned.append([thinning.thin(frame, step) for frame in frames])
        for place, value in enumerate(values):
            settings = knob.with_value(StreamSettings(codec=codec, intensity="off"), value)
            squares, count = 0.0, 0
            for frames in thinned:
                bits, decoded = sizes_of(settings, frames)
                ranges[at, place] += bits["range"] / points
                rest[at] += bits["rest"] / points / len(values)
                for frame, back in zip(frames, decoded, strict=True):
                    off = frame.range[frame.valid].astype(np.int64) - back.range[frame.valid]
                    squares, count = squares + float(np.dot(off, off)), count + len(off)
            rmse[at, place] = 0.002 * float(np.sqrt(squares / max(count, 1)))
            bound_m = value if bounded else rmse[at, place] * np.sqrt(3.0)
            worth[at, place] = np.exp(plane @ _terms(RETURNS / step, bound_m))
        for place, levels in enumerate(LEVELS):
            name = {0: "off", 256: "lossless"}.get(levels, f"levels={levels}")
            settings = knob.with_value(StreamSettings(codec=codec, intensity=name), values[len(values) // 2])
            for frames in thinned:
                levels_bits[at, place] += sizes_of(settings, frames)[0]["intensity"] / points
        print(f"{codec} 1/{step}: range", ranges[at].round(4).tolist(), "rest", round(rest[at], 4), file=sys.stderr)
        print("  levels", levels_bits[at].round(3).tolist(), "m", worth[at].round(4).tolist(), file=sys.stderr)
    return {
        "knob": knob.setting,
        "bounded": bounded,
        "steps": list(steps),
        "values": list(values),
        "levels": list(LEVELS),
        "range_bits": ranges.round(5).tolist(),
        "rest_bits": rest.round(5).tolist(),
        "intensity_bits": levels_bits.round(5).tolist(),
        "cost_m": worth.round(5).tolist(),
        "rmse_m": rmse.round(5).tolist(),
    }


def main() -> None:
    """Measure and print; with --write, keep."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("errors", type=Path, help="what `evaluate localisation --json` said")
    parser.add_argument("--codecs", default=",".join(name for name in table.names() if table.codec(name).knob))
    parser.add_argument("--frames", type=int, default=1, help="frames of each drive that are counted")
    parser.add_argument("--coarse", action="store_true", help="fewer points, of fewer drives")
    parser.add_argument("--write", action="store_true", help="keep the result")
    args = parser.parse_args()
    plane = errors_plane(json.loads(args.errors.read_text()))
    sets = drives(args.frames, DRIVES)
    entries: dict[str, Any] = json.loads(OUT.read_text()) if OUT.exists() else {}
    for codec in args.codecs.split(","):
        entries[codec] = measured(codec, sets[::2] if args.coarse else sets, plane, coarse=args.coarse)
        if args.write:
            OUT.write_text(table_text(entries))
    if not args.write:
        print(json.dumps(entries, indent=1))


if __name__ == "__main__":
    main()

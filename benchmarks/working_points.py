"""What each working point of a codec costs and shows: the table from which the rate control makes its operating curves.

    python -m benchmarks.working_points [--codecs riddle,pcodec] [--frames 3] [--steps 10 | --steps none] [--write]

A working point is a step of the lattice of columns, a value of the codec's knob and a number of intensity levels. For
each codec it measures, over frames of the training drives (0013, sfnd, 0001) and a simulated town, in bits per return
of the original frame: ranges (by step and knob), intensity (by step and levels: intensity_points.py), and all else (by
step); and what is seen at the receiver with gaps filled in: Chamfer distance, RMSE along the ray, RMSE of intensity.
With --write the table goes to lidarcodec/ratecontrol/working_points.json, one entry a codec; other codecs' entries
stay. All codecs take hours. --steps measures ranges of some steps alone, and keeps what the table has of the others;
intensities are measured anew each time, which takes two minutes.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from itertools import islice
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from benchmarks.intensity_points import Intensities, intensities
from benchmarks.scenes import DATA
from lidarcodec import api
from lidarcodec.codecs import table
from lidarcodec.evaluation.geometry import Cloud, xyz_of
from lidarcodec.filling import filled
from lidarcodec.frame import Frame
from lidarcodec.message import SectionType
from lidarcodec.pipeline import StreamDecoder, StreamEncoder
from lidarcodec.settings import StreamSettings
from lidarcodec.wire import size_of

OUT: Final = Path(__file__).parents[1] / "lidarcodec/ratecontrol/working_points.json"
DRIVES: Final = (
    ("kitti_0013_f052-107.pcap.xz", 10),
    ("kitti_sfnd_f000-049.pcap.xz", 10),
    ("kitti_0001_f000-089.pcap.xz", 40),
    ("sim:city?seed=3&packets=6960", 5),
)
STEPS: Final = (1, 2, 3, 4, 6, 8, 10, 12, 16, 24)
BOUNDS_M: Final = (0.0, 0.002, 0.008, 0.02, 0.045, 0.1, 0.2, 0.3)
QUALITIES: Final = (3, 5, 10, 20, 35, 50, 65, 80, 90, 95, 98, 100)
CRFS: Final = (48, 42, 36, 32, 28, 24, 20, 16, 12, 8, 4, 0)
LEVELS: Final = (0, 2, 3, 4, 5, 6, 7, 8, 10, 12, 16, 20, 24, 32, 48, 64, 96, 128, 256)
ROWS: Final = ("range_bits", "rest_bits", "chamfer_m", "rmse_m")
"""What an entry has of each step, but for intensity."""
Row = dict[str, Any]
Floats = npt.NDArray[np.float64]
FREE: Final = ("predictive", "riddle")
"""Codecs that choose values within a bound by what they cost, so that their distances are their own."""
WARM: Final = 2
"""Frames at the beginning that teach a codec and are not counted."""


def values_of(
    codec: str,
    bounds_m: Sequence[float] = BOUNDS_M[::-1],
    qualities: Sequence[int] = QUALITIES,
    crfs: Sequence[int] = CRFS,
) -> tuple[float, ...]:
    """The values of the codec's knob to measure, coarsest first; what is given is in that order, too."""
    knob = table.codec(codec).knob
    if knob is None:
        raise SystemExit(f"{codec} has no knob")
    if table.codec(codec).bounded:
        return tuple(bounds_m)
    return tuple(float(value) for value in (crfs if knob.setting == "crf" else qualities))


def drives(count: int, of: Sequence[tuple[str, int]] = DRIVES) -> list[list[Frame]]:
    """Frames of each drive: consecutive whole revolutions, the first WARM before those that are counted.

    of: captures or simulated drives, each with the revolutions to leave out at its beginning
    """
    found = []
    for name, skip in of:
        spec = name if name.startswith("sim:") else str(DATA / name)
        found.append(list(islice(api.read_frames(spec, framing="revolution"), skip, skip + WARM + count)))
    return found


def apart(original: Cloud, decoded: Floats) -> Floats:
    """(2,) metres: the mean distance from each original point to the nearest decoded one, and back. decoded: (N, 3)"""
    if not len(decoded):
        return np.full(2, np.inf)
    other = Cloud(decoded)
    there = np.linalg.norm(original.points - other.points[other.nearest(original.points)], axis=1)
    back = np.linalg.norm(other.points - original.points[original.nearest(other.points)], axis=1)
    return np.array([there.mean(), back.mean()])


def chamfer(original: Cloud, decoded: Frame) -> float:
    """Chamfer distance of one frame in metres, as evaluation.geometry defines it."""
    return float(apart(original, xyz_of(decoded.cloud())).max())


def table_text(found: dict[str, Any]) -> str:
    """The text of a table of working points, one row on each line."""
    return json.dumps(found, separators=(",", ":")).replace("],[", "],\n[") + "\n"


def coded(codec: str, step: int, settings: StreamSettings, frames: list[Frame]) -> tuple[dict[str, float], list[Frame]]:
    """Bits of the frames behind the first WARM, by part, and all frames as decoded; every step-th column is sent."""
    return sizes_of(settings.model_copy(update={"reduction": f"lattice:{step}"}), frames)


def sizes_of(settings: StreamSettings, frames: list[Frame]) -> tuple[dict[str, float], list[Frame]]:
    """Bits of the frames behind the first WARM, by part, and all frames as decoded."""
    encoder, decoder = StreamEncoder(settings, stream_id=1), StreamDecoder()
    bits, out = {"range": 0.0, "intensity": 0.0, "rest": 0.0}, []
    messages = [message for frame in frames for message in encoder.encode(frame)] + encoder.flush()
    seen = 0
    for message in messages:
        seen += message.frame_count
        out += decoder.decode(message)
        if seen <= WARM:
            continue
        share = min(seen - WARM, message.frame_count) / message.frame_count
        parts = {"range": SectionType.RANGE, "intensity": SectionType.INTENSITY}
        sizes = {name: sum(len(s.data) for s in message.sections if s.type == kind) for name, kind in parts.items()}
        table_of_key = sum(len(s.data) for s in message.sections if s.type in (SectionType.CALIBRATION,))
        sizes["rest"] = size_of(message) - sum(sizes.values()) - table_of_key * message.key
        for name, size in sizes.items():
            bits[name] += 8.0 * size * share
    return bits, out


def measured(codec: str, step: int, sets: list[list[Frame]], clouds: list[list[Cloud]], known: Row | None) -> Row:
    """What is known of a step but for intensity.

    clouds: of the frames that are counted;  known: of another codec that rounds, whose distances are the same
    """
    values = values_of(codec)
    knob = table.codec(codec).knob
    assert knob is not None
    points = sum(frame.points for frames in sets for frame in frames[WARM:])
    ranges, distance, rmse = np.zeros(len(values)), np.zeros(len(values)), np.zeros(len(values))
    rest = 0.0
    for place, value in enumerate(values):
        settings = knob.with_value(StreamSettings(codec=codec, intensity="off"), value)
        far, squares, count = [], 0.0, 0
        for frames, originals in zip(sets, clouds, strict=True):
            bits, decoded = coded(codec, step, settings, frames)
            ranges[place] += bits["range"] / points
            rest += bits["rest"] / points / len(values)
            if known is not None:
                continue
            for frame, cloud, back in zip(frames[WARM:], originals, decoded[WARM:], strict=True):
                far.append(chamfer(cloud, filled(back)))
                both = (frame.range > 0) & (back.range > 0)
                off = frame.range[both].astype(np.int64) - back.range[both]
                squares, count = squares + float(np.dot(off, off)), count + len(off)
        if known is None:
            distance[place] = float(np.mean(far))
            rmse[place] = 0.002 * float(np.sqrt(squares / max(count, 1)))
    found = {"range_bits": ranges.round(5).tolist(), "rest_bits": round(rest, 5)}
    found |= {"chamfer_m": distance.round(5).tolist(), "rmse_m": rmse.round(5).tolist()}
    if known is not None:
        found |= {name: known[name] for name in ("chamfer_m", "rmse_m")}
    print(f"{codec} 1/{step}:", found, file=sys.stderr, flush=True)
    return found


def rows_of(entry: dict[str, Any]) -> dict[int, Row]:
    """What is known of each step of a codec, but for intensity."""
    return {step: {name: entry[name][at] for name in ROWS} for at, step in enumerate(entry["steps"])}


def entry_of(codec: str, rows: dict[int, Row]) -> dict[str, Any]:
    """The codec's entry but for intensity."""
    knob = table.codec(codec).knob
    assert knob is not None
    head = {"knob": knob.setting, "bounded": table.codec(codec).bounded, "steps": sorted(rows)}
    head["values"] = list(values_of(codec))
    return head | {name: [rows[step][name] for step in sorted(rows)] for name in ROWS}


def of_intensity(found: Intensities) -> dict[str, Any]:
    """The part of a codec's entry that is about intensity."""
    return {
        "levels": list(LEVELS),
        "intensity_bits": found.bits.round(5).tolist(),
        "intensity_rmse": found.rmse.round(3).tolist(),
    }


def main() -> None:
    """Measure and print; with --write, keep."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--codecs", default=",".join(name for name in table.names() if table.codec(name).knob))
    parser.add_argument("--frames", type=int, default=3, help="frames of each drive that are counted")
    parser.add_argument("--steps", default=",".join(map(str, STEPS)), help="whose ranges are measured, or `none`")
    parser.add_argument("--write", action="store_true", help="keep the result")
    args = parser.parse_args()
    sets = drives(args.frames)
    entries: dict[str, Any] = json.loads(OUT.read_text()) if OUT.exists() else {}
    counted = [frame for frames in sets for frame in frames[WARM:]]
    clouds = [[Cloud(xyz_of(frame.cloud())) for frame in frames[WARM:]] for frames in sets]
    shades: dict[bool, Intensities] = {}
    steps = [] if args.steps == "none" else [int(step) for step in args.steps.split(",")]
    fresh: dict[int, Row] = {}
    for codec in args.codecs.split(","):
        grouped = codec == "zstd"
        if grouped not in shades:
            shades[grouped] = intensities(counted, STEPS, LEVELS, grouped=grouped)
        same = codec in entries and entries[codec]["values"] == list(values_of(codec))
        rows = rows_of(entries[codec]) if same else {}
        for step in steps:
            rounds = table.codec(codec).bounded and codec not in FREE
            rows[step] = measured(codec, step, sets, clouds, fresh.get(step) if rounds else None)
            if rounds:
                fresh[step] = rows[step]
        if set(rows) != set(STEPS):
            raise SystemExit(f"{codec}: steps {sorted(set(STEPS) - set(rows))} were never measured at these values")
        entries[codec] = entry_of(codec, rows) | of_intensity(shades[grouped])
        if args.write:
            OUT.write_text(table_text(entries))
    if not args.write:
        print(json.dumps(entries, indent=1))


if __name__ == "__main__":
    main()

"""What each working point of a codec costs and shows: the table from which the rate control makes its operating curves.

    python -m benchmarks.working_points [--codecs riddle,pcodec] [--frames 6] [--write]

A working point is a step of the lattice of columns, a value of the codec's knob and a number of intensity levels. For
each codec it measures, over frames of the training drives (0013, sfnd, 0001) and a simulated town, in bits per return
of the original frame: ranges (by step and knob), intensity (by step and levels), and all else (by step); and what is
seen at the receiver with gaps filled in: Chamfer distance, RMSE along the ray, RMSE of intensity. With --write the
table goes to lidarcodec/ratecontrol/working_points.json, one entry a codec; other codecs' entries stay.
"""

from __future__ import annotations

import argparse
import json
import sys
from itertools import islice
from pathlib import Path
from typing import Any, Final

import numpy as np

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
    ("sim:city?seed=3&frames=20", 5),
)
STEPS: Final = (1, 2, 3, 4, 6, 8, 12, 16, 24)
BOUNDS_M: Final = (0.0, 0.002, 0.004, 0.008, 0.012, 0.02, 0.03, 0.045, 0.065, 0.1, 0.14, 0.2, 0.3)
QUALITIES: Final = (3, 5, 10, 20, 35, 50, 65, 80, 90, 95, 98, 100)
CRFS: Final = (48, 42, 36, 32, 28, 24, 20, 16, 12, 8, 4, 0)
LEVELS: Final = (0, 2, 3, 4, 6, 8, 12, 16, 24, 32, 64, 128, 256)
WARM: Final = 2
"""Frames at the beginning that teach a codec and are not counted."""


def values_of(codec: str) -> tuple[float, ...]:
    """The values of the codec's knob to measure, coarsest first."""
    knob = table.codec(codec).knob
    if knob is None:
        raise SystemExit(f"{codec} has no knob")
    if table.codec(codec).bounded:
        return tuple(reversed(BOUNDS_M))
    return tuple(float(value) for value in (CRFS if knob.setting == "crf" else QUALITIES))


def drives(count: int) -> list[list[Frame]]:
    """Frames of each drive: consecutive whole revolutions."""
    found = []
    for name, skip in DRIVES:
        spec = name if name.startswith("sim:") else str(DATA / name)
        found.append(list(islice(api.read_frames(spec, framing="revolution"), skip, skip + WARM + count)))
    return found


def chamfer(original: Cloud, decoded: Frame) -> float:
    """Chamfer distance of one frame in metres, as evaluation.geometry defines it."""
    points = xyz_of(decoded.cloud())
    if not len(points):
        return float("inf")
    other = Cloud(points)
    there = np.linalg.norm(original.points - other.points[other.nearest(original.points)], axis=1)
    back = np.linalg.norm(other.points - original.points[original.nearest(other.points)], axis=1)
    return float(max(there.mean(), back.mean()))


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


def measured(codec: str, sets: list[list[Frame]], known: dict[str, Any] | None) -> dict[str, Any]:
    """The codec's entry. known: that of another codec with a bound, whose distances are the same."""
    values = values_of(codec)
    bounded = table.codec(codec).bounded
    knob = table.codec(codec).knob
    assert knob is not None
    points = sum(frame.points for frames in sets for frame in frames[WARM:])
    clouds = [[Cloud(xyz_of(frame.cloud())) for frame in frames[WARM:]] for frames in sets]
    shape = (len(STEPS), len(values))
    ranges, distance, rmse = np.zeros(shape), np.zeros(shape), np.zeros(shape)
    rest = np.zeros(len(STEPS))
    levels_bits, levels_rmse = np.zeros((len(STEPS), len(LEVELS))), np.zeros((len(STEPS), len(LEVELS)))
    for at, step in enumerate(STEPS):
        for place, value in enumerate(values):
            settings = knob.with_value(StreamSettings(codec=codec, intensity="off"), value)
            far, squares, count = [], 0.0, 0
            for frames, originals in zip(sets, clouds, strict=True):
                bits, decoded = coded(codec, step, settings, frames)
                ranges[at, place] += bits["range"] / points
                rest[at] += bits["rest"] / points / len(values)
                if known is not None:
                    continue
                for frame, cloud, back in zip(frames[WARM:], originals, decoded[WARM:], strict=True):
                    far.append(chamfer(cloud, filled(back)))
                    both = (frame.range > 0) & (back.range > 0)
                    off = frame.range[both].astype(np.int64) - back.range[both]
                    squares, count = squares + float(np.dot(off, off)), count + len(off)
            if known is None:
                distance[at, place] = float(np.mean(far))
                rmse[at, place] = 0.002 * float(np.sqrt(squares / max(count, 1)))
        for place, levels in enumerate(LEVELS):
            name = {0: "off", 256: "lossless"}.get(levels, f"levels={levels}")
            settings = knob.with_value(StreamSettings(codec=codec, intensity=name), values[len(values) // 2])
            squares, count = 0.0, 0
            for frames in sets:
                bits, decoded = coded(codec, step, settings, frames)
                levels_bits[at, place] += bits["intensity"] / points
                for frame, narrow in zip(frames[WARM:], decoded[WARM:], strict=True):
                    back = filled(narrow)
                    both = (frame.range > 0) & (back.range > 0)
                    off = frame.intensity[both].astype(np.int64) - back.intensity[both]
                    squares, count = squares + float(np.dot(off, off)), count + len(off)
            levels_rmse[at, place] = float(np.sqrt(squares / max(count, 1)))
        print(f"{codec} 1/{step}: range", ranges[at].round(3).tolist(), "rest", round(rest[at], 4), "levels",
              levels_bits[at].round(3).tolist(), levels_rmse[at].round(1).tolist(), "chamfer",
              distance[at].round(4).tolist(), file=sys.stderr, flush=True)  # fmt: skip
    if known is not None:
        distance, rmse = np.array(known["chamfer_m"]), np.array(known["rmse_m"])
    return {
        "knob": knob.setting,
        "bounded": bounded,
        "steps": list(STEPS),
        "values": list(values),
        "levels": list(LEVELS),
        "range_bits": ranges.round(5).tolist(),
        "rest_bits": rest.round(5).tolist(),
        "intensity_bits": levels_bits.round(5).tolist(),
        "chamfer_m": distance.round(5).tolist(),
        "rmse_m": rmse.round(5).tolist(),
        "intensity_rmse": levels_rmse.round(3).tolist(),
    }


def main() -> None:
    """Measure and print; with --write, keep."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--codecs", default=",".join(name for name in table.names() if table.codec(name).knob))
    parser.add_argument("--frames", type=int, default=6, help="frames of each drive that are counted")
    parser.add_argument("--write", action="store_true", help="keep the result")
    args = parser.parse_args()
    sets = drives(args.frames)
    entries: dict[str, Any] = json.loads(OUT.read_text()) if OUT.exists() else {}
    for codec in args.codecs.split(","):
        bounded = (entry for entry in entries.values() if entry["bounded"] and table.codec(codec).bounded)
        entries[codec] = measured(codec, sets, next(bounded, None))
        if args.write:
            OUT.write_text(json.dumps(entries, separators=(",", ":")).replace("],[", "],\n[") + "\n")
    if not args.write:
        print(json.dumps(entries, indent=1))


if __name__ == "__main__":
    main()

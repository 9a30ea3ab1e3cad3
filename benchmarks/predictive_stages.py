"""What each stage of `predictive` takes a return, in ticks and nanoseconds, and the whole beside other codecs.

    python -m benchmarks.predictive_stages [--frames 8] [--rounds 3] [--dry-run]

KITTI drive 0005, one core, intensity off; processor time, medians. Stages of the ranges are measured by a program built
from the core (native/check/stage_times.cpp), on each vector path of the processor; the others by stopwatches around the
native calls. Beside them in the same run: our `pcodec`, `jxl` at effort 1 and 7, and Draco on the same points. A line
goes to history/predictive-<machine>.jsonl.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from contextlib import ExitStack
from datetime import UTC, datetime
from importlib.util import find_spec
from itertools import islice
from pathlib import Path
from statistics import median
from time import thread_time
from typing import Any
from unittest.mock import patch

import numpy as np

from benchmarks.run import _commit, machine
from benchmarks.scenes import DATA, HERE
from lidarcodec import entropy
from lidarcodec.cloud import xyz_of
from lidarcodec.codecs.canvas import level_offsets
from lidarcodec.codecs.motion_finder import MotionFinder
from lidarcodec.codecs.warp import RangeHistory
from lidarcodec.entropy import fast
from lidarcodec.entropy.mask_coder import row_geometry
from lidarcodec.frame import Frame
from lidarcodec.pipeline import StreamDecoder, StreamEncoder, frames_of
from lidarcodec.settings import StreamSettings
from lidarcodec.sources import open_source

ROOT = HERE.parent
CORE = ROOT / "build" / "native" / "liblidarcodec_core.a"
CAPTURE, CALIBRATION = "kitti_0005.pcap.xz", "kitti_hdl64e_s2_recovered_db.xml"
BUDGET_MS = {"predictive, every frame a key": 12.0, "predictive": 12.0, "predictive with motion": 25.0}
"""Each way, a frame; the search for the motion is counted apart."""
SETTINGS = {
    "predictive, every frame a key": StreamSettings(
        codec="predictive", codec_settings={"memory": False}, key_interval=1, intensity="off"
    ),
    "predictive": StreamSettings(codec="predictive", intensity="off"),
    "predictive with motion": StreamSettings(codec="predictive", codec_settings={"motion": True}, intensity="off"),
    "pcodec": StreamSettings(codec="pcodec", intensity="off"),
    "jxl, effort 1": StreamSettings(codec="jxl", codec_settings={"effort": 1}, intensity="off"),
    "jxl, effort 7": StreamSettings(codec="jxl", codec_settings={"effort": 7}, intensity="off"),
}
SLOW = {"jxl, effort 7": 3}
"""Frames of what takes long."""


def frames(count: int) -> list[Frame]:
    """The first frames of the drive."""
    with open_source(DATA / CAPTURE, calibration=DATA / CALIBRATION) as source:
        return list(islice(frames_of(source.packets(), source.sensor), count))


def fed(given: list[Frame]) -> bytes:
    """What native/check/stage_times.cpp reads: the frames, and what each is expected to be."""
    half, rotation = row_geometry(given[0].sensor)
    levels = level_offsets(given[0].sensor).astype(np.int32)
    parts = [np.uint32(len(given)), half, rotation.astype(np.int64), levels]
    history, finder = RangeHistory(), MotionFinder()
    for frame in given:
        of_frame = (frame.azimuth, frame.fired, frame.sensor)
        expected = history.expected(finder.next(frame, history).motion, *of_frame)
        history.remember(frame.range, *of_frame)
        parts += [np.uint32(frame.width), frame.range, frame.valid.astype(np.uint8)]
        parts += [frame.fired.astype(np.uint8), expected]
    return b"".join(np.ascontiguousarray(part).tobytes() for part in parts)


def range_stages(given: list[Frame], rounds: int) -> dict[str, Any]:
    """Of each path its stages, ns a return, and the ticks of a nanosecond.

    Raises CalledProcessError if the program cannot be built or run; FileNotFoundError without the built core.
    """
    if not CORE.exists():
        raise FileNotFoundError(f"{CORE}: `make native` builds it")
    with tempfile.TemporaryDirectory() as folder:
        program = Path(folder) / "stage_times"
        words = ["-std=c++20", "-O3", "-ffp-contract=off", f"-I{ROOT / 'native' / 'src'}", "-pthread"]
        source = ROOT / "native" / "check" / "stage_times.cpp"
        subprocess.run([os.environ.get("CXX", "c++"), *words, source, CORE, "-o", program], check=True)
        data, paths = fed(given), {}
        for path in fast.coding_paths()[1:]:  # plain C++ runs nowhere by itself
            done = subprocess.run([program, path, str(rounds)], input=data, capture_output=True, check=True)
            first, *lines = done.stdout.decode().split("\n")[:-1]
            ticks = float(first)
            stages: dict[str, dict[str, float]] = {}
            for line in lines:
                way, stage, value = line.split(",")
                stages.setdefault(way, {})[stage] = round(float(value) / ticks, 2)
            paths[path] = stages
    return {"ticks_per_ns": ticks, "paths": paths}


class _Watch:
    """Calls of a function or an object's methods, timed: milliseconds by name."""

    def __init__(self) -> None:
        self.ms: dict[str, list[float]] = {}

    def call(self, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def timed(*given: Any, **named: Any) -> Any:
            begun = thread_time()
            result = function(*given, **named)
            self.ms.setdefault(name, []).append((thread_time() - begun) * 1e3)
            return result

        return timed


def whole(name: str, given: list[Frame]) -> dict[str, Any]:
    """Milliseconds a frame to encode and decode, bytes, and of them what native calls take.

    Raises AssertionError if ranges do not come back.
    """
    encoder, decoder, watch = StreamEncoder(SETTINGS[name]), StreamDecoder(), _Watch()
    times: dict[str, list[float]] = {"encode": [], "decode": []}
    size = 0
    with ExitStack() as stack:
        for place, method in (
            (entropy, "encode_mask"),
            (entropy, "decode_mask"),
            (entropy.PredictiveCoder, "encode"),
            (entropy.PredictiveCoder, "decode"),
            (RangeHistory, "expected"),
            (RangeHistory, "remember"),
            (MotionFinder, "next"),
        ):
            named = {"next": "motion search", "encode": "encode ranges", "decode": "decode ranges"}.get(method, method)
            original = getattr(place, method)
            timed = watch.call(named.replace("expected", "warp").replace("_", " "), original)
            stack.enter_context(patch.object(place, method, _method(timed) if isinstance(place, type) else timed))
        for frame in given:
            begun = thread_time()
            messages = encoder.encode(frame)
            encoded = thread_time()
            (came,) = [frame for message in messages for frame in decoder.decode(message)]
            times["decode"].append((thread_time() - encoded) * 1e3)
            times["encode"].append((encoded - begun) * 1e3)
            size += sum(len(section.data) for message in messages for section in message.sections)
            assert (came.range == frame.range).all()
    parts = {part: round(median(ms[1:]), 2) for part, ms in watch.ms.items() if len(ms) > 1}
    return {way: round(median(ms[1:]), 2) for way, ms in times.items()} | {"bytes": size // len(given), "parts": parts}


def _method(function: Callable[..., Any]) -> Callable[..., Any]:
    def method(self: Any, *given: Any, **named: Any) -> Any:
        return function(self, *given, **named)

    return method


def draco(given: list[Frame]) -> dict[str, Any] | None:
    """Draco on the points of each frame, its box in 2^14 parts; None where it is not installed."""
    if find_spec("DracoPy") is None:
        return None
    import DracoPy

    times: dict[str, list[float]] = {"encode": [], "decode": []}
    size = 0
    for frame in given:
        points = np.stack([axis[frame.valid.T] for axis in xyz_of(frame, np.float32)], axis=1)
        begun = thread_time()
        data = DracoPy.encode(points, quantization_bits=14, compression_level=10, preserve_order=False)
        encoded = thread_time()
        DracoPy.decode(data)
        times["decode"].append((thread_time() - encoded) * 1e3)
        times["encode"].append((encoded - begun) * 1e3)
        size += len(data)
    return {way: round(median(ms), 2) for way, ms in times.items()} | {"bytes": size // len(given)}


def measure(count: int, rounds: int) -> dict[str, Any]:
    """Everything, as one line of history."""
    given = frames(count)
    line: dict[str, Any] = {
        "commit": _commit(),
        "date": f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ}",
        "machine": machine(),
    }
    line["returns"] = int(np.mean([frame.valid.sum() for frame in given]))
    line["load"] = round(os.getloadavg()[0], 1)
    line["ranges_ns"] = range_stages(given, rounds)
    line["codecs_ms"] = {name: whole(name, given[: SLOW.get(name, count)]) for name in SETTINGS}
    peer = draco(given)
    if peer is not None:
        line["codecs_ms"]["Draco, 14 bits"] = peer
    return line


def text(line: dict[str, Any]) -> str:
    """The line as a table."""
    ticks = line["ranges_ns"]["ticks_per_ns"]
    out = [f"ranges: ns a return, in brackets ticks of a counter of {ticks:.2f} GHz; load {line['load']}"]
    for path, ways in line["ranges_ns"]["paths"].items():
        for way, stages in ways.items():
            cells = ", ".join(f"{stage} {ns:.1f} ({ns * ticks:.0f})" for stage, ns in stages.items())
            out.append(f"  {path:6} {way:20} {cells}")
    best = line["codecs_ms"]["predictive"]
    out.append("whole: ms a frame each way, and as a multiple of `predictive`")
    for name, found in line["codecs_ms"].items():
        over = [f"{found[way]:8.2f} ({found[way] / best[way]:5.2f})" for way in ("encode", "decode")]
        search = found.get("parts", {}).get("motion search", 0.0)
        budget = BUDGET_MS.get(name)
        late = budget is not None and max(found["encode"] - search, found["decode"]) > budget
        note = "" if budget is None else f"  budget {budget:g}{', OVER' if late else ''}"
        out.append(f"  {name:30}{'  '.join(over)}  {found['bytes']:7} bytes{note}")
        if found.get("parts"):
            out.append("      " + ", ".join(f"{part} {ms:.2f}" for part, ms in sorted(found["parts"].items())))
    return "\n".join(out)


def main() -> int:
    """Measure, print, and add to the history."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=8)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--dry-run", action="store_true", help="measure, and leave the history as it is")
    chosen = parser.parse_args()
    line = measure(chosen.frames, chosen.rounds)
    print(text(line))
    if not chosen.dry_run:
        path = HERE / "history" / f"predictive-{machine()}.jsonl"
        with path.open("a") as file:
            file.write(json.dumps(line, separators=(",", ":")) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())

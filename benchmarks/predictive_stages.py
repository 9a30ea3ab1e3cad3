"""What each stage of `predictive` and `riddle` takes a return, in ticks and ns, and the whole beside other codecs.

    python -m benchmarks.predictive_stages [--frames 8] [--rounds 3] [--source SOURCE] [--dry-run]

KITTI drive 0005, one core, intensity off; medians. Stages of the ranges are measured by a program built from the core
(benchmarks/range_stages.py), for each kind of processor that the one at hand can pass for; the others by stopwatches
around the native calls, in processor time. Beside them in the same run, frame by frame in turns: our `pcodec`, `jxl` at
effort 1 and 7, and Draco on the same points. Then how many frames a second of two streams two threads decode. A line
goes to history/predictive-<machine>.jsonl.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from datetime import UTC, datetime
from importlib.util import find_spec
from itertools import islice
from pathlib import Path
from statistics import median
from time import thread_time
from typing import Any
from unittest.mock import patch

import numpy as np

from benchmarks.range_stages import KITTI_WEIGHTS, build, stages
from benchmarks.run import _commit, machine
from benchmarks.scenes import DATA, FRAMING, HERE
from benchmarks.thread_scaling import thread_scaling
from lidarcodec import entropy
from lidarcodec.cloud import xyz_of
from lidarcodec.codecs.frame_decoder import PlaneReader
from lidarcodec.frame import Frame
from lidarcodec.message import SectionType
from lidarcodec.motion.finder import MotionFinder
from lidarcodec.motion.warp import RangeHistory
from lidarcodec.pipeline import StreamDecoder, StreamEncoder, frames_of
from lidarcodec.settings import StreamSettings
from lidarcodec.sources import open_source

CAPTURE, CALIBRATION = "kitti_0005.pcap.xz", "kitti_hdl64e_s2_recovered_db.xml"
BUDGET_MS = {"predictive, every frame a key": 12.0, "predictive": 12.0, "predictive with motion": 25.0}
"""Each way, a frame; the search for the motion is counted apart."""
DRACO = "Draco, 14 bits"
PEERS = ("pcodec", "jxl, effort 1", "jxl, effort 7", DRACO)
"""Codecs that the others are compared with."""


def _settings(codec: str, **own: Any) -> StreamSettings:
    return StreamSettings(codec=codec, codec_settings=own, intensity="off")


SETTINGS = {
    "predictive, every frame a key": _settings("predictive", memory=False).model_copy(update={"key_interval": 1}),
    "predictive": _settings("predictive"),
    "predictive with motion": _settings("predictive", motion=True),
    "predictive, effort 2, with motion": _settings("predictive", motion=True, effort=2),
    "riddle, effort 2": _settings("riddle", effort=2),
    "riddle, effort 3": _settings("riddle", effort=3),
    "riddle, effort 4": _settings("riddle", effort=4),
    "riddle, effort 4, KITTI": _settings("riddle", effort=4, weights=str(KITTI_WEIGHTS)),
    "pcodec": _settings("pcodec"),
    "jxl, effort 1": _settings("jxl", effort=1),
    "jxl, effort 7": _settings("jxl", effort=7),
}
"""`riddle` is with motion, as it is by default."""
IN_THREADS = ("riddle, effort 2", "riddle, effort 4")


def frames(spec: str, calibration: Path | None, count: int, thin: int) -> list[Frame]:
    """The first frames of a source; of each every `thin`th column, as of a sensor that turns so much faster."""
    with open_source(spec, calibration=calibration) as source:
        given = list(islice(frames_of(source.packets(), source.sensor, FRAMING), count))
    return given if thin == 1 else [_thinned(frame, thin) for frame in given]


def _thinned(frame: Frame, thin: int) -> Frame:
    names = ("range", "intensity", "azimuth", "fired")
    return frame.with_(**{name: getattr(frame, name)[:, ::thin] for name in names}, side=None)


class _Watch:
    """Calls of functions and methods, timed: milliseconds by codec and name."""

    def __init__(self) -> None:
        self.ms: dict[str, dict[str, list[float]]] = {}
        self.codec = ""

    def call(self, name: str, function: Callable[..., Any], *given: Any, **named: Any) -> Any:
        begun = thread_time()
        result = function(*given, **named)
        self.ms.setdefault(self.codec, {}).setdefault(name, []).append((thread_time() - begun) * 1e3)
        return result

    @contextmanager
    def on(self, *places: tuple[Any, str, str]) -> Iterator[None]:
        """Times what is found in these places under these names, and calls it as the last says."""
        with ExitStack() as stack:
            for place, method, name in places:
                stack.enter_context(patch.object(place, method, self._timed(name, getattr(place, method))))
            yield

    def _timed(self, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def timed(*given: Any, **named: Any) -> Any:  # a function, so that it is bound to an object as a method is
            return self.call(name, function, *given, **named)

        return timed


WATCHED = (
    (entropy, "encode_mask", "encode mask"),
    (entropy.MaskStream, "encode", "encode mask"),
    (entropy.PredictiveCoder, "encode", "encode ranges"),
    (PlaneReader, "read", "decode session"),
    (RangeHistory, "expected", "warp"),
    (RangeHistory, "remember", "remember"),
    (MotionFinder, "next", "motion search"),
)


def whole(given: list[Frame]) -> dict[str, dict[str, Any]]:
    """Of each codec milliseconds a frame to encode and decode, bytes but those of weights, and what native calls take.

    All codecs take turns with each frame; the first one warms up. Raises AssertionError if ranges do not come back.
    """
    watch = _Watch()
    ends = {name: (StreamEncoder(settings), StreamDecoder()) for name, settings in SETTINGS.items()}
    times: dict[str, dict[str, list[float]]] = {}
    sizes = dict.fromkeys((*SETTINGS, DRACO), 0)

    def took(name: str, begun: float, encoded: float, size: int) -> None:
        of_codec = times.setdefault(name, {"encode": [], "decode": []})
        of_codec["decode"].append((thread_time() - encoded) * 1e3)
        of_codec["encode"].append((encoded - begun) * 1e3)
        sizes[name] += size

    with watch.on(*WATCHED):
        for frame in given:
            for name, (encoder, decoder) in ends.items():
                watch.codec = name
                begun = thread_time()
                messages = encoder.encode(frame)
                encoded = thread_time()
                (came,) = [frame for message in messages for frame in decoder.decode(message)]
                sections = [section for message in messages for section in message.sections]
                size = sum(len(section.data) for section in sections if section.type != SectionType.WEIGHTS)
                took(name, begun, encoded, size)
                assert (came.range == frame.range).all()
            if find_spec("DracoPy") is not None:
                took(DRACO, *_draco(frame))
    found = {}
    for name, ways in times.items():
        found[name] = {way: round(median(ms[1:]), 2) for way, ms in ways.items()} | {"bytes": sizes[name] // len(given)}
        if name in watch.ms:
            found[name]["parts"] = {part: round(median(ms[1:]), 2) for part, ms in watch.ms[name].items() if ms[1:]}
    return found


def _draco(frame: Frame) -> tuple[float, float, int]:
    """When Draco begins with a frame's points, their box in 2^14 parts, and has encoded them; bytes. Decodes them."""
    import DracoPy

    points = np.stack([axis[frame.valid.T] for axis in xyz_of(frame, np.float32)], axis=1)
    begun = thread_time()
    data = DracoPy.encode(points, quantization_bits=14, compression_level=10, preserve_order=False)
    encoded = thread_time()
    DracoPy.decode(data)
    return begun, encoded, len(data)


def measure(given: list[Frame], rounds: int, options: list[str]) -> dict[str, Any]:
    """Everything, as one line of history. options: what the program of the stages is built with."""
    line: dict[str, Any] = {
        "commit": _commit(),
        "date": f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ}",
        "machine": machine(),
        "frames": len(given),
    }
    line["returns"] = int(np.mean([frame.valid.sum() for frame in given]))
    line["load"] = round(os.getloadavg()[0], 1)
    with tempfile.TemporaryDirectory() as folder:
        line["ranges_ns"] = stages(build(Path(folder), options), given, rounds)
    line["codecs_ms"] = whole(given)
    line["threads"] = {name: thread_scaling(given, SETTINGS[name], rounds) for name in IN_THREADS}
    line["load_after"] = round(os.getloadavg()[0], 1)
    return line


def text(line: dict[str, Any]) -> str:
    """The line as tables."""
    return "\n".join([*_stages_text(line), *_whole_text(line), *_peers_text(line), *_threads_text(line)])


def _stages_text(line: dict[str, Any]) -> list[str]:
    ticks = line["ranges_ns"]["ticks_per_ns"]
    load = f"load {line['load']} before, {line['load_after']} after"
    out = [f"ranges: ns a return, in brackets ticks of a counter of {ticks:.2f} GHz; {load}"]
    for processor, codecs in line["ranges_ns"]["processors"].items():
        for codec, ways in codecs.items():
            out.append(f"  {processor}: {codec}")
            for way, found in ways.items():
                cells = ", ".join(f"{stage} {ns:.1f} ({ns * ticks:.0f})" for stage, ns in found.items())
                out.append(f"    {way:20} {cells}")
    return out


def _whole_text(line: dict[str, Any]) -> list[str]:
    best = line["codecs_ms"]["predictive"]
    out = ["whole: ms a frame each way, and as a multiple of `predictive`"]
    for name, found in line["codecs_ms"].items():
        over = [f"{found[way]:8.2f} ({found[way] / best[way]:5.2f})" for way in ("encode", "decode")]
        search = found.get("parts", {}).get("motion search", 0.0)
        budget = BUDGET_MS.get(name)
        late = budget is not None and max(found["encode"] - search, found["decode"]) > budget
        note = "" if budget is None else f"  budget {budget:g}{', OVER' if late else ''}"
        out.append(f"  {name:30}{'  '.join(over)}  {found['bytes']:7} bytes{note}")
        if found.get("parts"):
            out.append("      " + ", ".join(f"{part} {ms:.2f}" for part, ms in sorted(found["parts"].items())))
    return out


def _peers_text(line: dict[str, Any]) -> list[str]:
    codecs = line["codecs_ms"]
    peers = [name for name in PEERS if name in codecs]
    out = [
        "beside others: how many times as long as each it takes, encode / decode",
        " " * 32 + "".join(f"{name:>18}" for name in peers),
    ]
    for name, found in codecs.items():
        if name not in peers:
            over = [
                " / ".join(f"{found[way] / codecs[peer][way]:.2f}" for way in ("encode", "decode")) for peer in peers
            ]
            out.append(f"  {name:30}" + "".join(f"{cell:>18}" for cell in over))
    return out


def _threads_text(line: dict[str, Any]) -> list[str]:
    out = []
    for name, found in line["threads"].items():
        one, two = (found["frames_per_s"][threads] for threads in ("1", "2"))
        busy, queued = (
            " and ".join(f"{found[what][threads]:.1f}" for threads in ("1", "2"))
            for what in ("processor_ms", "queued_ms")
        )
        rates = f"{one:.1f} of one stream on one thread, {two:.1f} of two on two: {two / one:.2f} times"
        out.append(f"  {name:20} {rates}; a frame takes {busy} ms of a core, and waits for one {queued} ms")
    cores = next(iter(line["threads"].values()))["cores"]
    return [f"thread scaling: frames decoded a second, measured on {cores} shared cores", *out]


def main() -> int:
    """Measure, print, and add to the history."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=8, help="2 or more: the first one warms up")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--source", help="instead of KITTI drive 0005, for a look only: its line is not kept")
    parser.add_argument("--thin", type=int, default=1, help="of each frame every so many columns; its line is not kept")
    parser.add_argument(
        "--unoptimised", action="store_true", help="whether it runs, not how fast; its line is not kept"
    )
    parser.add_argument("--dry-run", action="store_true", help="measure, and leave the history as it is")
    chosen = parser.parse_args()
    kept = not (chosen.dry_run or chosen.source or chosen.thin != 1 or chosen.unoptimised)
    source = (chosen.source, None) if chosen.source else (str(DATA / CAPTURE), DATA / CALIBRATION)
    given = frames(*source, chosen.frames, chosen.thin)
    if len(given) < 2:
        parser.error(f"{source[0]} and --frames {chosen.frames} give {len(given)} frames: 2 or more are needed")
    line = measure(given, chosen.rounds, ["-O0" if chosen.unoptimised else "-O3"])
    print(text(line))
    if kept:
        path = HERE / "history" / f"predictive-{machine()}.jsonl"
        with path.open("a") as file:
            file.write(json.dumps(line, separators=(",", ":")) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())

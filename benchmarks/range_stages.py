"""What each stage of coding ranges takes a return: runs native/check/stage_times.cpp, built from the core at hand.

Stages: `canvas`: rows are laid beside each other; `contexts` of a return are found; `inputs` of its network; `network`;
`sums` of what contexts, and the network, say; `learning` of contexts, and of what each of the two counts; `coder and
offsets`: the range coder, where in its leaf a range lies, and what is noted of it; `whole`: as the product has it,
unwatched. `coder and offsets` is what the others leave of it.
"""

from __future__ import annotations

import os
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.scenes import HERE
from lidarcodec.entropy import fast
from lidarcodec.entropy.mask_coder import row_geometry
from lidarcodec.frame import Frame
from lidarcodec.motion.finder import MotionFinder
from lidarcodec.motion.warp import RangeHistory
from lidarcodec.network.networks import Net
from lidarcodec.network.shelf import networks_of, weights_of
from lidarcodec.ranges.image.canvas import level_offsets

ROOT = HERE.parent
CORE = ROOT / "build" / "native" / "liblidarcodec_core.a"
COMPILER = os.environ.get("CXX", "c++")
KITTI_WEIGHTS = HERE / "weights" / "riddle-kitti.lcrw"

Ways = dict[str, dict[str, float]]
"""Nanoseconds a return by way (`encode`, `decode with motion`, ...) and stage."""


class Processor(NamedTuple):
    """What a kind of processor codes with: a path and a form of networks."""

    path: str
    form: str

    def __str__(self) -> str:
        return self.form


def processors() -> list[Processor]:
    """Kinds that the processor at hand can pass for, the best last: any of its family, with AVX2, with AVX-512 VNNI.

    On ARM: any, with dot products.
    """
    paths, forms = fast.coding_paths(), fast.net_forms()
    return [Processor(paths[1], forms[1]), *(Processor(paths[-1], form) for form in forms[2:])]


def networks() -> dict[str, list[Net]]:
    """Of each codec and effort its networks: of frames alone, of those that expect something. None: `predictive`."""
    found: dict[str, list[Net]] = {"predictive": []}
    found |= {f"riddle, effort {effort}": networks_of(weights_of(""), effort) for effort in (2, 3, 4)}
    return found | {"riddle, effort 4, KITTI": networks_of(weights_of(str(KITTI_WEIGHTS)), 4)}


def build(folder: Path, options: Sequence[str] = ("-O3",)) -> Path:
    """The program, built in a folder.

    Raises CalledProcessError if it does not compile, FileNotFoundError without a compiler or the built core.
    """
    if not CORE.exists():
        raise FileNotFoundError(f"{CORE}: `make native` builds it")
    program, source = folder / "stage_times", ROOT / "native" / "check" / "stage_times.cpp"
    words = ["-std=c++20", *options, "-ffp-contract=off", f"-I{ROOT / 'native' / 'src'}", "-pthread"]
    subprocess.run([COMPILER, *words, source, CORE, "-o", program], check=True)
    return program


def stages(program: Path, given: list[Frame], rounds: int) -> dict[str, Any]:
    """Of each kind of processor and codec its stages, ns a return, and the ticks of a nanosecond.

    Raises CalledProcessError if the program fails, for example because ranges do not come back.
    """
    frames = fed(given)
    kinds: dict[str, dict[str, Ways]] = {}
    ticks, paths = 0.0, set[str]()
    for processor in processors():
        codecs = kinds[str(processor)] = {}
        for codec, nets in networks().items():
            if not nets and processor.path in paths:
                continue  # it has none, so that their form is nothing to it
            paths.add(processor.path)
            words = [program, processor.path, processor.form, str(rounds)]
            done = subprocess.run(words, input=_networks_fed(nets) + frames, stdout=subprocess.PIPE, check=True)
            first, *lines = done.stdout.decode().splitlines()
            ticks = float(first)
            codecs[codec] = _ways(lines, ticks)
    return {"ticks_per_ns": ticks, "processors": kinds}


def _ways(lines: list[str], ticks: float) -> Ways:
    found: Ways = {}
    for line in lines:
        way, stage, value = line.split(",")
        found.setdefault(way, {})[stage] = round(float(value) / ticks, 2)
    return found


def _networks_fed(nets: list[Net]) -> bytes:
    parts = [np.uint32(len(nets)).tobytes()]
    for layer in (layer for net in nets for layer in net.layers):
        out, into = layer.weights.shape
        head = np.array([into, out, layer.shift, len(layer.cases)], np.uint32)
        parts += [array.tobytes() for array in (head, np.ascontiguousarray(layer.weights), layer.bias, layer.cases)]
    return b"".join(parts)


def fed(given: list[Frame]) -> bytes:
    """What the program reads behind the networks: the frames, and what each is expected to be."""
    half, rotation = row_geometry(given[0].sensor)
    levels = level_offsets(given[0].sensor).astype(np.int32)
    parts = [np.uint32(len(given)), half, rotation.astype(np.int64), levels]
    history, finder = RangeHistory(), MotionFinder()
    for frame in given:
        of_frame = (frame.azimuth, frame.fired, frame.sensor)
        motion = finder.next(frame, history).motion
        expected = history.expected(motion, *of_frame)
        history.remember(frame.range_u16, *of_frame)
        parts += [np.uint32(frame.width), frame.range_u16, frame.valid.astype(np.uint8)]
        parts += [frame.fired.astype(np.uint8), expected]
    return b"".join(np.ascontiguousarray(part).tobytes() for part in parts)

"""Simulated drives beside real ones: what they cost, and how their returns are spread. Prints a Markdown table.

    python -m benchmarks.simulator_realism              the city in 12 seeds, and every KITTI drive that is at hand
    python -m benchmarks.simulator_realism SOURCE ...   any sources

A frame is 348 packets. Bits are those of the returns alone, ring by ring from the top, each in its order of firing.
kitti_0005 is shown for checking; nothing was tuned on it.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from itertools import islice
from pathlib import Path

import numpy as np
import numpy.typing as npt
import zstandard
from pcodec import ChunkConfig, DeltaSpec, ModeSpec, standalone

from benchmarks.scenes import DATA, FRAMING
from lidarcodec.frame import Frame
from lidarcodec.pipeline import frames_of
from lidarcodec.sources import open_source
from lidarcodec.units import FRAME_PACKETS

DRIVES = ("kitti_sfnd_f000-049", "kitti_0013_f052-107", "kitti_0005")
CALIBRATION = "kitti_hdl64e_s2_recovered_db.xml"
SEEDS = range(1, 13)
PLACES = (0, 200, 600, 1100)
STEP = 11
"""2.2 cm: errors of at most 1 cm."""
KITTI_LEVELS = 99
ROWS: dict[str, Callable[[Frame], float]] = {
    "returns of all cells, %": lambda f: 100 * f.points / f.range.size,
    "range, lossless, bit/return": lambda f: _bits(f, 1),
    "range, steps of 2.2 cm, bit/return": lambda f: _bits(f, STEP),
    "mask, zstd of packed bits, bit/return": lambda f: _zstd(np.packbits(f.valid), f),
    "intensity, zstd 3, bit/return": lambda f: _zstd(f.intensity[f.valid], f),
    "intensity in KITTI's 100 levels, zstd 3, bit/return": lambda f: _zstd(_levels(f), f),
    "intensity 0, % of returns": lambda f: 100 * float(np.mean(f.intensity[f.valid] == 0)),
    "difference to the return before, median, 2 mm": lambda f: float(np.median(_differences(f))),
    "difference to the return before, p90, 2 mm": lambda f: float(np.percentile(_differences(f), 90)),
    "range, p10, m": lambda f: float(np.percentile(f.range[f.valid], 10) * 0.002),
    "range, median, m": lambda f: float(np.percentile(f.range[f.valid], 50) * 0.002),
    "range, p90, m": lambda f: float(np.percentile(f.range[f.valid], 90) * 0.002),
    "returns, rings 0-15, %": lambda f: 100 * float(np.mean(f.valid[:16])),
    "returns, rings 16-31, %": lambda f: 100 * float(np.mean(f.valid[16:32])),
    "returns, rings 32-47, %": lambda f: 100 * float(np.mean(f.valid[32:48])),
    "returns, rings 48-63, %": lambda f: 100 * float(np.mean(f.valid[48:])),
}
"""What is measured of a frame; the table shows the mean over frames."""


def _bits(frame: Frame, step: int) -> float:
    values = frame.range[frame.valid].astype(np.uint32)
    indices = ((values + step // 2) // step).astype(np.uint16)
    config = ChunkConfig(compression_level=8, delta_spec=DeltaSpec.try_consecutive(1), mode_spec=ModeSpec.classic())
    return 8 * len(standalone.simple_compress(indices, config)) / frame.points


def _zstd(values: npt.NDArray[np.uint8], frame: Frame) -> float:
    return 8 * len(zstandard.ZstdCompressor(level=3).compress(values.tobytes())) / frame.points


def _levels(frame: Frame) -> npt.NDArray[np.uint8]:
    levels: npt.NDArray[np.float64] = np.rint(frame.intensity[frame.valid] * (KITTI_LEVELS / 255))
    return levels.astype(np.uint8)


def _differences(frame: Frame) -> npt.NDArray[np.int64]:
    rings = [np.abs(np.diff(ring[ring > 0].astype(np.int64))) for ring in frame.range]
    return np.concatenate(rings)


def frames(spec: str, calibration: Path | None, every: int = 1, most: int | None = None) -> Iterator[Frame]:
    """Whole frames of a source, one in `every`."""
    with open_source(spec, calibration=calibration) as source:
        for frame in islice(frames_of(source.packets(), source.sensor, FRAMING), 0, most, every):
            if frame.side is not None and frame.side.packets == FRAME_PACKETS:
                yield frame


def column(chosen: Iterator[Frame]) -> list[float]:
    """The mean of every row over some frames."""
    values = [[float(measure(frame)) for measure in ROWS.values()] for frame in chosen]
    return [float(v) for v in np.mean(np.array(values), axis=0)]


def city() -> Iterator[Frame]:
    """One frame at each of a few places of each of a few towns."""
    for seed in SEEDS:
        for skip in PLACES:
            yield from frames(f"sim:city?seed={seed}&packets=348&skip={skip}", None)


def main(sources: list[str]) -> None:
    """Prints the table."""
    columns: dict[str, list[float]] = {}
    if sources:
        columns = {spec: column(frames(spec, None, most=400)) for spec in sources}
    else:
        columns["sim:city"] = column(city())
        for name in DRIVES:
            path = DATA / f"{name}.pcap.xz"
            if path.exists():
                columns[name] = column(frames(str(path), DATA / CALIBRATION, every=4))
            else:
                print(f"{path} is not here: left out", file=sys.stderr)
    print("| | " + " | ".join(columns) + " |")
    print("|---|" + "---:|" * len(columns))
    for index, name in enumerate(ROWS):
        print(f"| {name} | " + " | ".join(f"{values[index]:.4g}" for values in columns.values()) + " |")


if __name__ == "__main__":
    main(sys.argv[1:])

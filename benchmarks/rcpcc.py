"""Ours against RCPCC (HITSZ-NRSL/RCPCC, ICRA 2025) at the same bits.

    python -m benchmarks.rcpcc DRIVER [--drive 0005] [--calibration db.xml] [--save]

RCPCC states no licence, so its code is not here. DRIVER is your own program around it, called as

    DRIVER IN.bin LEVEL OUT.bin

with clouds of float32 x, y, z, intensity, and whose last line on standard error has `bytes N`. Both get the same
frames; neither sends intensities. RCPCC codes each frame by itself. Ours is a stream with the target bitrate that
RCPCC's bytes come to, gaps filled in at the receiver. The first frame is also compared alone: ours by the best setting
that takes no more bytes.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import tempfile
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from benchmarks import results
from benchmarks.rate_pictures import COMPARED, DRIVES
from benchmarks.scenes import DATA, FRAMING
from benchmarks.working_points import apart
from lidarcodec import api
from lidarcodec.evaluation.geometry import Cloud, xyz_of
from lidarcodec.filling import filled
from lidarcodec.frame import Frame
from lidarcodec.pipeline import StreamDecoder, StreamEncoder
from lidarcodec.settings import StreamSettings
from lidarcodec.wire import size_of

LEVELS: Final = (0, 2, 3, 5)
STEPS: Final = (1, 2, 3, 4, 6, 8, 12, 16, 24)
BOUNDS_M: Final = (0.02, 0.03, 0.045, 0.065, 0.1, 0.14, 0.2, 0.3)
HEAD: Final = (
    "| frames | who | bits a return | original to decoded, cm | decoded to original, cm |\n|---|---|---:|---:|---:|"
)

Points = npt.NDArray[np.float64]


def theirs(driver: Path, points: Points, level: int) -> tuple[int, Points]:
    """Bytes and decoded points of RCPCC.

    Raises ValueError when the driver does not say how many bytes it took; CalledProcessError when it fails.
    """
    with tempfile.TemporaryDirectory() as name:
        given, back = Path(name) / "in.bin", Path(name) / "out.bin"
        np.column_stack([points, np.zeros(len(points))]).astype(np.float32).tofile(given)
        done = subprocess.run([driver, given, str(level), back], check=True, capture_output=True, text=True)
        size = re.search(r"bytes (\d+)", done.stderr)
        if size is None:
            raise ValueError(f"{driver} did not say how many bytes it took")
        return int(size[1]), np.fromfile(back, np.float32).reshape(-1, 4)[:, :3].astype(np.float64)


def shown(frame: Frame) -> Points:
    """The points that a viewer sees: gaps between the columns that were sent are filled in."""
    return xyz_of((frame if frame.lattice is None else filled(frame)).cloud())


def streamed(frames: list[Frame], codec: str, kbps: float) -> Iterator[tuple[Frame, int, Frame]]:
    """Each frame that a target bitrate sent, with its bytes and what came back."""
    settings = StreamSettings(codec=codec, target_kbps=kbps, intensity="off")
    encoder, decoder = StreamEncoder(settings, 1), StreamDecoder()
    for frame in frames:
        for message in encoder.encode(frame):
            for back in decoder.decode(message):
                yield frame, size_of(message), back


def alone(frame: Frame, original: Cloud, codec: str, most: int) -> tuple[int, npt.NDArray[np.float64]]:
    """Bytes and distances of a frame that refers to no other, by the best columns and bound within `most` bytes."""
    found: list[tuple[float, int, npt.NDArray[np.float64]]] = []
    for step in STEPS:
        for bound in BOUNDS_M:
            settings = StreamSettings(codec=codec, max_error_m=bound, intensity="off", reduction=f"lattice:{step}")
            (message,) = StreamEncoder(settings, 1).encode(frame)
            if (size := size_of(message)) <= most:
                (back,) = StreamDecoder().decode(message)
                both = apart(original, shown(back))
                found.append((float(both.max()), size, both))
                break  # a coarser bound takes fewer bytes and shows less
    _, size, both = min(found, key=lambda one: one[0])
    return size, both


def rows(driver: Path, frames: list[Frame], codec: str) -> Iterator[str]:
    """Lines of the table, level by level."""
    clouds = {at: Cloud(xyz_of(frames[at].cloud())) for at in range(0, len(frames), COMPARED)}
    points = sum(frames[at].points for at in clouds)
    every = f"every {COMPARED}th of {len(frames)}"
    for level in LEVELS:
        peer = {at: theirs(driver, cloud.points, level) for at, cloud in clouds.items()}
        far = {at: apart(cloud, peer[at][1]) for at, cloud in clouds.items()}
        size = sum(one[0] for one in peer.values())
        yield _line(every, f"RCPCC, level {level}", size / points, np.mean(list(far.values()), axis=0))
        kbps = 8.0 * size / len(clouds) * 10.0 / 1e3
        places = {frame.index: at for at, frame in enumerate(frames)}
        sent, ours = 0, []
        for frame, took, back in streamed(frames, codec, kbps):
            sent += took
            if (at := places[frame.index]) in clouds:
                ours.append(apart(clouds[at], shown(back)))
        whole = sum(frame.points for frame in frames)
        yield _line(every, f"`{codec}`, `target_kbps={kbps:.0f}`", sent / whole, np.mean(ours, axis=0))
        yield _line("the first", f"RCPCC, level {level}", peer[0][0] / frames[0].points, far[0])
        took, both = alone(frames[0], clouds[0], codec, peer[0][0])
        yield _line("the first", f"`{codec}`, this frame alone", took / frames[0].points, both)


def _line(frames: str, who: str, size: float, metres: npt.NDArray[np.float64]) -> str:
    there, back = 100.0 * metres
    return f"| {frames} | {who} | {8.0 * size:.2f} | {there:.1f} | {back:.1f} |"


def main() -> None:
    """Measure, print, and with --save keep the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("driver", type=Path)
    parser.add_argument("--drive", default="0005", choices=DRIVES)
    parser.add_argument("--codec", default="riddle")
    parser.add_argument("--calibration", type=Path, help="of the sensor that recorded the drive, a db.xml or yaml")
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--save", action="store_true", help="into benchmarks/results/rcpcc.csv")
    given = parser.parse_args()
    spec = DRIVES[given.drive]
    source = spec if spec.startswith("sim:") else str(DATA / spec)
    frames = list(islice(api.read_frames(source, FRAMING, calibration=given.calibration), given.frames))
    lines = [HEAD]
    print(HEAD)
    for line in rows(given.driver.resolve(), frames, given.codec):
        lines.append(line)
        print(line, flush=True)
    if given.save:
        results.save("rcpcc", "\n".join(lines), title="RCPCC", about=f"Drive {given.drive}.")


if __name__ == "__main__":
    main()

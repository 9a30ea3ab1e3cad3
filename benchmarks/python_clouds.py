"""Frames a second of one core in Python: reading a capture, with the points of each frame, and decoding a recording.

    python -m benchmarks.python_clouds [CAPTURE] [--frames 60] [--rounds 5]

Times are of the processor, medians of rounds in which each takes its turn. The ratio of reading with points and reading
alone is that of one run: other work on the machine falls on both. Frames are turns.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable, Iterable
from itertools import islice
from pathlib import Path
from statistics import median
from time import process_time

import lidarcodec
from benchmarks.scenes import DATA
from lidarcodec.sources.captures.pcap_writer import PcapWriter

CALIBRATION = "kitti_hdl64e_s2_recovered_db.xml"


def per_frame_ms(frames: Callable[[], Iterable[lidarcodec.Frame]], *, clouds: bool) -> float:
    """Processor time of a frame."""
    count, started = 0, process_time()
    for frame in frames():
        count += 1
        if clouds:
            frame.cloud()
    return (process_time() - started) / count * 1e3


def measure(capture: str | Path, frames: int, rounds: int) -> dict[str, float]:
    """Medians in ms a frame: `read`, `read and points`, `decode`, `decode and points`, and `points` alone."""
    calibration = DATA / CALIBRATION if "kitti" in str(capture) else None
    with tempfile.TemporaryDirectory() as folder:
        plain = Path(folder) / "plain.pcap"  # unpacking .xz is not what is timed
        with lidarcodec.open_source(capture, calibration=calibration) as source, plain.open("wb") as file:
            turns = islice(lidarcodec.read_frames(source), frames)
            PcapWriter(file).write_all(packet for frame in turns for packet in lidarcodec.packets_of(frame))

        def read() -> Iterable[lidarcodec.Frame]:
            return lidarcodec.read_frames(plain, calibration=calibration)

        messages = list(lidarcodec.encode(read()))
        kept = list(islice(read(), 8))
        times: dict[str, list[float]] = {}
        for _ in range(rounds):
            for name, source_of, clouds in (
                ("read", read, False), ("read and points", read, True),
                ("decode", lambda: lidarcodec.decode(messages), False),
                ("decode and points", lambda: lidarcodec.decode(messages), True),
                ("points", lambda: iter(kept), True),
            ):  # fmt: skip
                times.setdefault(name, []).append(per_frame_ms(source_of, clouds=clouds))
    return {name: median(values) for name, values in times.items()}


def main() -> int:
    """Measure, and print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.python_clouds", description=__doc__)
    parser.add_argument("capture", nargs="?", default=str(DATA / "kitti_0005.pcap.xz"))
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--rounds", type=int, default=5)
    given = parser.parse_args()
    found = measure(given.capture, given.frames, given.rounds)
    for name, ms in found.items():
        print(f"{name:<18} {ms:6.2f} ms a frame, {1e3 / ms:6.0f} frames a second")
    print(f"read and points / read: {found['read and points'] / found['read']:.2f}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

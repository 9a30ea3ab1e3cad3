"""The first frames of a stream: bits a return of `riddle`, beside `pcodec`, ours and the library's, on the same frames.

    python -m benchmarks.first_frames [--drives 0005,0013] [--frames 5] [--save]

Every stream begins with its key frame. Bits are those of range, mask and motion, lossless and with the two bounds;
every frame is decoded, and its errors are what they may be. `pcodec` the library gets the returns of a frame row by
row, at its highest level, and our mask, which is smaller than what it could make of one itself. Networks trained on
KITTI are in no package and travel with every key frame, 72 and 90 kB that are not counted.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from itertools import islice
from typing import Any

from benchmarks import results
from benchmarks.range_table import BOUNDS, COUNTED, DRIVES, OF_KITTI, OF_KITTI_VNNI, check, frames_of_drive
from lidarcodec.codecs import table
from lidarcodec.entropy import encode_mask
from lidarcodec.evaluation.peers.pcodec_returns import compress_returns, decompress_returns
from lidarcodec.frame import Frame
from lidarcodec.settings import StreamSettings
from lidarcodec.wire import pack, unpack

OWN = "`pcodec`"
LIBRARY = "pcodec, the library, and our mask"
ROWS: dict[str, tuple[str, dict[str, Any]]] = {
    "`riddle` as installed": ("riddle", {}),
    "`riddle effort=4`": ("riddle", {"effort": 4}),
    "the same, networks trained on KITTI": ("riddle", {"effort": 4, "weights": OF_KITTI}),
    "the same with more weights": ("riddle", {"effort": 4, "weights": OF_KITTI_VNNI}),
    "`predictive motion=true`": ("predictive", {"motion": True}),
    OWN: ("pcodec", {}),
}


def of_stream(frames: Sequence[Frame], codec: str, own: dict[str, Any], bound: float) -> int:
    """Bytes of frames coded as the beginning of a stream."""
    settings = StreamSettings(codec=codec, codec_settings=own, max_error_m=bound, intensity="off")
    encoder, decoder = table.make_encoder(settings, 1), table.make_decoder(table.codec_id(codec))
    size = 0
    for frame in frames:
        for message in encoder.encode(frame):
            received = unpack(pack(message))
            (decoded,) = decoder.decode(received)
            check(decoded.range, frame, bound)
            size += sum(len(section.data) for section in received.sections if section.type in COUNTED)
    return size


def of_library(frames: Sequence[Frame], bound: float) -> int:
    """Bytes of the same frames by pcodec the library."""
    size = 0
    for frame in frames:
        data = compress_returns(frame.range, bound)
        check(decompress_returns(data, frame.valid, bound), frame, bound)
        size += len(data) + len(encode_mask(frame.valid, frame.fired, frame.sensor))
    return size


def measure(drive: str, number: int) -> str:
    """The table of a drive."""
    frames = list(islice(frames_of_drive(drive), number))
    sizes = {name: [of_stream(frames, *row, bound) for bound in BOUNDS] for name, row in ROWS.items()}
    sizes[LIBRARY] = [of_library(frames, bound) for bound in BOUNDS]
    points = sum(frame.points for frame in frames)

    def shares(row: list[int], of: str) -> str:
        return " / ".join(f"{one / base:.3f}" for one, base in zip(row, sizes[of], strict=True))

    lines = [f"#### {DRIVES[drive][0]}", "", f"{len(frames)} frames, {points / len(frames):,.0f} returns each.", ""]
    lines += [
        f"| coder | lossless | 1 cm | 5 cm | over pcodec, the library | over {OWN} |",
        "|---|---:|---:|---:|---:|---:|",
    ]
    for name, row in sizes.items():
        cells = [f"{8 * size / points:.3f}" for size in row]
        lines.append(f"| {' | '.join([name, *cells, shares(row, LIBRARY), shares(row, OWN)])} |")
    return "\n".join(lines)


def main() -> int:
    """Measure, and print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.first_frames", description=__doc__)
    drives = [drive for drive in DRIVES if drive not in ("singles", "s3", "odometry")]  # which have no five frames
    parser.add_argument("--drives", default=",".join(drives), help="of " + ", ".join(DRIVES))
    parser.add_argument("--frames", type=int, default=5, help="how many")
    parser.add_argument("--save", action="store_true", help="into benchmarks/results/first-frames")
    chosen = parser.parse_args()
    if chosen.frames < 1 or not set(chosen.drives.split(",")) <= set(DRIVES):
        parser.error("one frame at least, of drives that are there")
    for drive in chosen.drives.split(","):
        of_drive = measure(drive, chosen.frames)
        print(of_drive, flush=True)
        if chosen.save:
            results.save(f"first-frames/{drive}", of_drive)
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""What a target bitrate shows, with no other setting touched.

    python -m benchmarks.rate_pictures [--codecs riddle,pcodec] [--drives 0005] [--save]

For each target: kbit/s sent with everything counted, the mean of five seconds that is furthest above the target (of the
whole stretch if it is shorter), the Chamfer distance with gaps filled in at the receiver and of measured returns alone,
bits of intensity over returns of the original frames, its RMSE with gaps filled in, and frames that were left out.
--save writes benchmarks/results/targets/DRIVE-CODEC.csv.
"""

from __future__ import annotations

import argparse
from itertools import islice
from typing import Any, Final

import numpy as np

from benchmarks import results
from benchmarks.rate_table import Sent
from benchmarks.scenes import DATA, FRAMING
from benchmarks.working_points import chamfer
from lidarcodec import api
from lidarcodec.evaluation.geometry import Cloud, xyz_of
from lidarcodec.filling import filled
from lidarcodec.frame import Frame
from lidarcodec.message import SectionType
from lidarcodec.pipeline import StreamDecoder, StreamEncoder
from lidarcodec.settings import StreamSettings
from lidarcodec.units import PACKET_INTERVAL_US
from lidarcodec.wire import size_of

TARGETS: Final = (300, 450, 600, 750, 1000, 1500, 2500, 4000)
DRIVES: Final = {
    "0005": "kitti_0005.pcap.xz",
    "0006": "kitti_tracking0006_f000-010.pcap.xz",
    "0013": "kitti_0013_f052-107.pcap.xz",
    "sfnd": "kitti_sfnd_f000-049.pcap.xz",
    "city": "sim:city?packets=20880",
}
HEAD: Final = (
    "| target, kbit/s | sent | worst 5 s | Chamfer, m | measured returns alone "
    "| intensity, bits a return | its RMSE, of 255 | frames left out |\n"
    "|---:|---:|---:|---:|---:|---:|---:|---:|"
)
COMPARED: Final = 5
"""Distances are those of every so many-th frame."""


def shown(frames: list[Frame], codec: str, target: float) -> dict[str, Any]:
    """A row: what came of the target."""
    encoder, decoder = StreamEncoder(StreamSettings(codec=codec, target_kbps=target), 1), StreamDecoder()
    bits = np.zeros(len(frames))
    by_index = {frame.index: place for place, frame in enumerate(frames)}
    intensity, left, near, far, squares, shades = 0.0, 0, [], [], 0.0, 0

    def take(messages: list[Any]) -> None:
        nonlocal intensity, squares, shades
        for message in messages:
            first = by_index[message.frame_index]
            bits[first : first + message.frame_count] = 8 * size_of(message) / message.frame_count
            intensity += 8 * sum(len(s.data) for s in message.sections if s.type == SectionType.INTENSITY)
            for back in decoder.decode(message):
                place = by_index[back.index]
                if place % COMPARED == 0:
                    original = Cloud(xyz_of(frames[place].cloud()))
                    far.append(chamfer(original, back))
                    whole = filled(back)
                    near.append(far[-1] if back.lattice is None else chamfer(original, whole))
                    both = (frames[place].range > 0) & (whole.range > 0)
                    off = frames[place].intensity[both].astype(np.int64) - whole.intensity[both]
                    squares, shades = squares + float(np.dot(off, off)), shades + len(off)

    for frame in frames:
        take(encoder.encode(frame))
        left += encoder.left_out
    take(encoder.flush())
    seconds = np.array([PACKET_INTERVAL_US * 1e-6 * (frame.side.packets if frame.side else 348) for frame in frames])
    window = min(5.0, float(seconds.sum()) - 1e-6)
    worst = Sent(seconds, bits, {}).means(window, 0.0).max()
    points = sum(frame.points for frame in frames)
    return {
        "sent": bits.sum() / seconds.sum() / 1e3,
        "worst": worst / target - 1.0,
        "filled_m": float(np.mean(near)),
        "measured_m": float(np.mean(far)),
        "intensity": intensity / points,
        "shades": float(np.sqrt(squares / max(shades, 1))),
        "left": left,
    }


def main() -> None:
    """Measure, print, and with --save keep the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--codecs", default="riddle,pcodec")
    parser.add_argument("--drives", default="0005")
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--save", action="store_true", help="into benchmarks/results/targets")
    given = parser.parse_args()
    for drive in given.drives.split(","):
        spec = DRIVES[drive]
        source = spec if spec.startswith("sim:") else str(DATA / spec)
        frames = list(islice(api.read_frames(source, FRAMING), given.frames))
        for codec in given.codecs.split(","):
            lines = [HEAD]
            print(f"{drive}, {codec}", HEAD, sep="\n")
            for target in TARGETS:
                row = shown(frames, codec, target)
                lines.append(
                    f"| {target:,} | {row['sent']:,.0f} | {100 * row['worst']:+.1f} % |"
                    f" {row['filled_m']:.3f} | {row['measured_m']:.3f} | {row['intensity']:.2f} | {row['shades']:.1f} |"
                    f" {row['left']} |"
                )
                print(lines[-1], flush=True)
            if given.save:
                results.save(f"targets/{drive}-{codec}", "\n".join(lines), title=f"Drive {drive}, `{codec}`")


if __name__ == "__main__":
    main()

"""Free ranges against rounded ones: bits a return, errors and milliseconds, on the same frames in the same run.

    python -m benchmarks.free_ranges [--drives 0005] [--codecs riddle] [--save]

Every eighth frame of a drive behind the frame before it. Bits are those of range, mask and motion, the mask's part
beside them. Each frame is coded with both shapes in turns, and decoded; the bound is checked at every return. Times are
of the process, of one core, median of the frames. Chamfer distance as `bench` has it.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass, field

import numpy as np

from benchmarks import results
from benchmarks.range_table import COUNTED, DRIVES, check, pairs, timed
from benchmarks.working_points import chamfer
from lidarcodec.codecs import table
from lidarcodec.evaluation.geometry import Cloud, xyz_of
from lidarcodec.frame import Frame
from lidarcodec.message import Message, SectionType
from lidarcodec.settings import StreamSettings
from lidarcodec.wire import pack, unpack

SHAPES = ("rounded", "free")
STEP_CM = 0.2


@dataclass
class Found:
    """Sums over the frames of a drive."""

    bits: int = 0
    mask_bits: int = 0
    points: int = 0
    squares: float = 0.0
    chamfer_m: list[float] = field(default_factory=list)
    encode_ms: list[float] = field(default_factory=list)
    decode_ms: list[float] = field(default_factory=list)

    @property
    def rmse_cm(self) -> float:
        """Root of the mean square error of ranges."""
        return STEP_CM * float(np.sqrt(self.squares / max(self.points, 1)))

    def cells(self) -> str:
        """Bits, mask's part, errors, times: of a row of a table."""
        numbers = (f"{self.bits / self.points:.3f}", f"{self.mask_bits / self.points:.3f}", f"{self.rmse_cm:.2f}")
        times = f"{np.median(self.encode_ms):.1f} / {np.median(self.decode_ms):.1f}"
        return " | ".join((*numbers, f"{100 * float(np.mean(self.chamfer_m)):.2f}", times))


def of_frame(found: Found, settings: StreamSettings, before: Frame | None, frame: Frame, cloud: Cloud) -> None:
    """Code and decode a frame, and count it."""
    encoder, decoder = table.make_encoder(settings, 1), table.make_decoder(table.codec_id(settings.codec))
    if before is not None:
        for message in encoder.encode(before):
            decoder.decode(unpack(pack(message)))
    written, encode_ms = timed(lambda: [pack(message) for message in encoder.encode(frame)])
    messages: list[Message] = [unpack(data) for data in written]
    decoded, decode_ms = timed(lambda: [one for message in messages for one in decoder.decode(message)])
    came = decoded[0].range
    check(came, frame, settings.max_error_m or 0.0)
    sections = [section for message in messages for section in message.sections]
    found.bits += 8 * sum(len(section.data) for section in sections if section.type in COUNTED)
    found.mask_bits += 8 * sum(len(section.data) for section in sections if section.type == SectionType.MASK)
    found.points += frame.points
    found.squares += float(np.square(came.astype(float) - frame.range).sum())
    found.chamfer_m.append(chamfer(cloud, decoded[0]))
    found.encode_ms.append(encode_ms)
    found.decode_ms.append(decode_ms)


def measure(drive: str, codecs: list[str], bounds: list[float], every: int) -> str:
    """The table of a drive."""
    found = {(codec, bound, shape): Found() for codec in codecs for bound in bounds for shape in SHAPES}
    frames = 0
    for before, frame in pairs(drive, every):
        frames, cloud = frames + 1, Cloud(xyz_of(frame.cloud()))
        for (codec, bound, shape), of in found.items():
            settings = StreamSettings(codec=codec, max_error_m=bound, intensity="off", shape=shape)
            of_frame(of, settings, before, frame, cloud)
        print(f"{drive}: {frames} frames", file=sys.stderr)
    lines = [
        f"#### {DRIVES[drive][0]}, {frames} frames",
        "",
        "| codec | bound, cm | shape | bits a return | of the mask | RMSE, cm | Chamfer, cm | encode / decode ms |",
        "|---|---:|---|---:|---:|---:|---:|---:|",
    ]
    lines += [f"| `{codec}` | {100 * b:g} | {shape} | {of.cells()} |" for (codec, b, shape), of in found.items()]
    return "\n".join(lines)


def main() -> int:
    """Measure, and print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.free_ranges", description=__doc__)
    parser.add_argument("--drives", default="0005,0013,sfnd,city", help="of " + ", ".join(DRIVES))
    parser.add_argument("--codecs", default="riddle,predictive")
    parser.add_argument("--bounds", default="0.01,0.02,0.05,0.1,0.2", help="metres")
    parser.add_argument("--every", type=int, default=8, help="which frames")
    parser.add_argument("--save", action="store_true", help="into benchmarks/results/free-ranges")
    chosen = parser.parse_args()
    bounds = [float(bound) for bound in chosen.bounds.split(",")]
    for drive in chosen.drives.split(","):
        of_drive = measure(drive, chosen.codecs.split(","), bounds, chosen.every)
        print(of_drive, flush=True)
        if chosen.save:
            results.save(f"free-ranges/{drive}", of_drive)
    return 0


if __name__ == "__main__":
    sys.exit(main())

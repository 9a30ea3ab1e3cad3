"""Ranges against every peer: bits a return and milliseconds, drive by drive, on the same frames in the same run.

    python -m benchmarks.range_table [--drives 0005,0013] [--every 8] [--save]

Ours are measured on every eighth frame, alone and after the frame before it; peers alone, but FFV1, which keeps
statistics, too. Bits are those of range, mask and motion; all that a peer writes. Times are of one processor core, of
this process alone, median of the frames. Every frame is decoded, and its errors are what they may be. --save writes
benchmarks/results/ranges/DRIVE.csv.
"""

from __future__ import annotations

import argparse
import lzma
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from benchmarks import results, split
from benchmarks.scenes import DATA, FRAMING
from lidarcodec.codecs import table
from lidarcodec.evaluation.geometry import xyz_of
from lidarcodec.evaluation.peers.table import peer
from lidarcodec.frame import Frame
from lidarcodec.message import Message, SectionType
from lidarcodec.pipeline import frames_of
from lidarcodec.settings import StreamSettings
from lidarcodec.sources import open_source
from lidarcodec.wire import pack, unpack

BOUNDS = (0.0, 0.01, 0.05)
COUNTED = (SectionType.RANGE, SectionType.MASK, SectionType.KEEP, SectionType.MOTION)
KITTI = "kitti_hdl64e_s2_recovered_db.xml"
ODOMETRY = tuple(f"kitti_odometry_00_{number:06}.bin.xz" for number in range(3))
DRIVES: dict[str, tuple[str, str, str | None]] = {
    split.NAME: (split.TITLE, split.FILE, split.CALIBRATION),
    "0005": ("KITTI raw, drive 0005 (test)", "kitti_0005.pcap.xz", KITTI),
    "0013": ("KITTI raw, drive 0013", "kitti_0013_f052-107.pcap.xz", KITTI),
    "sfnd": ("KITTI raw, drive `sfnd`", "kitti_sfnd_f000-049.pcap.xz", KITTI),
    "0006": ("KITTI tracking 0006: the car stands", "kitti_tracking0006_f000-010.pcap.xz", KITTI),
    "odometry": ("KITTI odometry 00, moved by its motion and re-gridded", "", None),
    "s3": ("HDL-64E S3, real capture", "hdl64e_s3_atwall.pcap", "hdl64e_s3_atwall_db.xml"),
    "city": ("simulated town", "sim:city?seed=1&packets=14616", None),
    "road": ("simulated road", "sim:road?seed=1&packets=14616", None),
}

OF_KITTI = str(Path(__file__).parent / "weights" / "riddle-kitti.lcrw")
OF_KITTI_VNNI = str(Path(__file__).parent / "weights" / "riddle-kitti-vnni.lcrw")
"""For measuring only, see `weights/`. The second has more weights, for processors with AVX-512 VNNI."""


class Ours(NamedTuple):
    """A row: a codec of ours, its own settings, and whether it sees the frame before."""

    name: str
    codec: str
    own: dict[str, Any]
    after: bool = False


OURS = (
    Ours("`predictive`, a frame alone", "predictive", {"memory": False}),
    Ours("`predictive`, after the frame before", "predictive", {}, after=True),
    Ours("`predictive motion=true`, after the frame before", "predictive", {"motion": True}, after=True),
    Ours("`predictive effort=2`, a frame alone", "predictive", {"memory": False, "effort": 2}),
    Ours("`predictive effort=2 motion=true`, after it", "predictive", {"motion": True, "effort": 2}, after=True),
    Ours("`riddle effort=2`, a frame alone", "riddle", {"memory": False}),
    Ours("`riddle effort=3`, a frame alone", "riddle", {"memory": False, "effort": 3}),
    Ours("`riddle effort=4`, a frame alone", "riddle", {"memory": False, "effort": 4}),
    Ours("`riddle effort=1`, after the frame before", "riddle", {"effort": 1}, after=True),
    Ours("`riddle effort=2`, after the frame before", "riddle", {}, after=True),
    Ours("`riddle effort=3`, after the frame before", "riddle", {"effort": 3}, after=True),
    Ours("`riddle effort=4`, after the frame before", "riddle", {"effort": 4}, after=True),
    Ours("the same, networks trained on 0001, 0013, `sfnd`", "riddle", {"effort": 4, "weights": OF_KITTI}, after=True),
    Ours("the same with more weights, for AVX-512 VNNI", "riddle", {"effort": 4, "weights": OF_KITTI_VNNI}, after=True),
    Ours("a frame alone, trained as the first of these", "riddle", {"effort": 4, "weights": OF_KITTI, "memory": False}),
    Ours("`pcodec`", "pcodec", {}),
    Ours("`zstd`", "zstd", {}),
    Ours("`jxl`", "jxl", {}),
    Ours("`png`", "png", {}),
)
PEERS: dict[str, tuple[float, float, float]] = {
    "peer:xz-rows": BOUNDS,
    "peer:pcodec": BOUNDS,
    "peer:ffv1": BOUNDS,
    "peer:jpegls": BOUNDS,
    "peer:lerc": BOUNDS,
    "peer:draco": (14, 13, 11),
    "peer:laszip": (0.001, 0.02, 0.1),
}
"""Values of a peer's knob for the three bounds. Draco and LASzip divide x, y and z: their errors are larger."""


@dataclass
class Row:
    """Bits and times of a coder over the frames of a drive, for one bound."""

    bits: int = 0
    points: int = 0
    encode_ms: list[float] = field(default_factory=list)
    decode_ms: list[float] = field(default_factory=list)

    def add(self, size: int, points: int, encode_ms: float, decode_ms: float) -> None:
        """Count a frame."""
        self.bits += 8 * size
        self.points += points
        self.encode_ms.append(encode_ms)
        self.decode_ms.append(decode_ms)


def timed(call: Callable[[], Any]) -> tuple[Any, float]:
    """What a call gives, and the milliseconds of processor time that it took."""
    started = time.process_time()
    result = call()
    return result, (time.process_time() - started) * 1e3


def check(came: npt.NDArray[np.uint16], frame: Frame, bound: float) -> None:
    """Stop where decoded ranges are not what they may be."""
    off = np.abs(came.astype(int) - frame.range)
    if off.max() * 0.002 > bound + 1e-9 or ((came > 0) != frame.valid).any():
        raise AssertionError(f"frame {frame.index} breaks its bound of {bound} m")


def of_ours(row: Ours, bound: float, before: Frame | None, frame: Frame) -> tuple[int, float, float]:
    """Bytes and times of one frame."""
    settings = StreamSettings(codec=row.codec, codec_settings=row.own, max_error_m=bound, intensity="off")
    encoder, decoder = table.make_encoder(settings, 1), table.make_decoder(table.codec_id(row.codec))
    if row.after and before is not None:
        for message in encoder.encode(before):
            decoder.decode(unpack(pack(message)))
    written, encode_ms = timed(lambda: [pack(message) for message in encoder.encode(frame) + encoder.flush()])
    messages: list[Message] = [unpack(data) for data in written]
    decoded, decode_ms = timed(lambda: [one for message in messages for one in decoder.decode(message)])
    check(decoded[0].range, frame, bound)
    size = sum(len(section.data) for message in messages for section in message.sections if section.type in COUNTED)
    return size, encode_ms, decode_ms


def of_peer(name: str, value: float, before: Frame | None, frame: Frame) -> tuple[int, float, float]:
    """The same of a peer."""
    found = peer(name)
    coder = found.make(value)

    def fed(one: Frame) -> Any:
        if found.feed == "ranges":
            return one.range
        cloud = one.cloud()
        return xyz_of(cloud[np.argsort(cloud["ring"], kind="stable")])  # as KITTI's files have them: costs least

    if name == "peer:ffv1" and before is not None and before.width == frame.width:
        coder.decode(coder.encode(fed(before)))
    given = fed(frame)
    data, encode_ms = timed(lambda: coder.encode(given))
    _, decode_ms = timed(lambda: coder.decode(data))
    return len(data), encode_ms, decode_ms


def frames_of_drive(drive: str) -> Iterator[Frame]:
    """The frames of a drive, up to one that is cut short."""
    _, file, calibration = DRIVES[drive]
    with tempfile.TemporaryDirectory() as folder:
        spec = file if file.startswith("sim:") else str(DATA / file)
        if drive == "odometry":
            spec = folder
            for name in ODOMETRY:
                (Path(folder) / name.removeprefix("kitti_odometry_00_").removesuffix(".xz")).write_bytes(
                    lzma.decompress((DATA / name).read_bytes())
                )
        with open_source(spec, calibration=None if calibration is None else DATA / calibration) as source:
            for frame in islice(frames_of(source.packets(), source.sensor, FRAMING), 400):
                if frame.side is not None and frame.side.packets < 300:
                    break
                yield frame


def pairs(drive: str, every: int) -> Iterator[tuple[Frame | None, Frame]]:
    """Every so many frames of a drive with the one before; all of one that is short."""
    if drive == split.NAME:
        yield from ((None, frame) for frame in split.frames())
        return
    before: Frame | None = None
    step = 1 if drive in ("odometry", "s3") else 2 if drive == "0006" else every
    for number, frame in enumerate(frames_of_drive(drive)):
        if number % step == 0 and (number or drive == "s3"):
            yield before, frame
        before = frame


def measure(drive: str, every: int) -> str:
    """The table of a drive."""
    blind = drive == split.NAME
    ours_here = [row for row in OURS if not blind or not (row.after or "weights" in row.own)]
    names = [row.name for row in ours_here] + [f"`{name}`" for name in PEERS]
    rows = {name: [Row() for _ in BOUNDS] for name in names}
    frames = points = 0
    for before, frame in pairs(drive, every):
        frames, points = frames + 1, points + frame.points
        for at, bound in enumerate(BOUNDS):
            for ours in ours_here:
                rows[ours.name][at].add(*(found := of_ours(ours, bound, before, frame))[:1], frame.points, *found[1:])
            for name, values in PEERS.items():
                rows[f"`{name}`"][at].add(
                    *(found := of_peer(name, values[at], before, frame))[:1], frame.points, *found[1:]
                )
        print(f"{drive}: {frames} frames", file=sys.stderr)
    lines = [
        f"#### {DRIVES[drive][0]}",
        f"{frames} frames, {points / max(frames, 1):,.0f} returns each.",
        "| coder | lossless | 1 cm | 5 cm | encode ms | decode ms |\n|---|---:|---:|---:|---:|---:|",
    ]
    best = [min(row[at].bits for row in rows.values()) for at in range(len(BOUNDS))]
    body = []
    for name, row in rows.items():
        cells = [f"{one.bits / max(one.points, 1):.2f}" for one in row]
        cells = [
            f"**{cell}**" if one.bits == least else cell for cell, one, least in zip(cells, row, best, strict=True)
        ]
        times = [" / ".join(f"{np.median(getattr(one, way)):.1f}" for one in row) for way in ("encode_ms", "decode_ms")]
        body.append(f"| {name} | {' | '.join(cells + times)} |")
    return "\n\n".join(lines) + "\n" + "\n".join(body)


def main() -> int:
    """Measure, and print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.range_table", description=__doc__)
    parser.add_argument("--drives", default=",".join(DRIVES), help="of " + ", ".join(DRIVES))
    parser.add_argument("--every", type=int, default=8, help="which frames")
    parser.add_argument("--save", action="store_true", help="into benchmarks/results/ranges")
    chosen = parser.parse_args()
    for drive in chosen.drives.split(","):
        table_of_drive = measure(drive, chosen.every)
        print(table_of_drive, flush=True)
        if chosen.save:
            results.save(f"ranges/{drive}", table_of_drive)
    return 0


if __name__ == "__main__":
    sys.exit(main())

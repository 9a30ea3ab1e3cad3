"""Sizes and errors of codecs by plane, as Markdown.

    python -m benchmarks.tables [--scenes singles,0005] [--frames N] [--save]

Scenes: the simulated town, and whatever of the shared captures lies in LIDARCODEC_DATA. Single scans are coded each by
itself. --save writes benchmarks/results/codecs/SCENE.csv. `peers` are no codecs of ours:
zstd and xz over the bare payloads of each frame of 348 packets.
"""

from __future__ import annotations

import argparse
import lzma
import sys
from collections.abc import Callable, Iterator
from itertools import islice
from typing import Any

import zstandard

from benchmarks import results, split
from benchmarks.scenes import DATA, FRAMING
from lidarcodec.evaluation.bench import bench
from lidarcodec.evaluation.report import label
from lidarcodec.pipeline import frames_of
from lidarcodec.settings import StreamSettings
from lidarcodec.sources import open_source

KITTI = "kitti_hdl64e_s2_recovered_db.xml"
SCENES = {
    split.NAME: (split.TITLE, split.FILE, split.CALIBRATION),
    "0005": ("KITTI raw, drive 0005", "kitti_0005.pcap.xz", KITTI),
    "0013": ("KITTI raw, drive 0013", "kitti_0013_f052-107.pcap.xz", KITTI),
    "sfnd": ("KITTI raw, drive `sfnd`", "kitti_sfnd_f000-049.pcap.xz", KITTI),
    "s3": ("HDL-64E S3, real capture", "hdl64e_s3_atwall.pcap", "hdl64e_s3_atwall_db.xml"),
    "city": ("simulated town", "sim:city?seed=1&packets=34800", None),
}
SETTINGS = (
    StreamSettings(codec="pcodec"),
    StreamSettings(codec="pcodec", max_error_m=0.01),
    StreamSettings(codec="pcodec", max_error_m=0.05),
    *(
        StreamSettings(codec="predictive", codec_settings=own, max_error_m=bound)
        for own in ({}, {"motion": True})
        for bound in (None, 0.01, 0.05)
    ),
    *(
        StreamSettings(codec="riddle", codec_settings=own, max_error_m=bound)
        for own in ({}, {"effort": 4})
        for bound in (None, 0.01, 0.05)
    ),
    StreamSettings(codec="zstd"),
    StreamSettings(codec="zstd", max_error_m=0.01),
    StreamSettings(codec="raw"),
)
PEERS: dict[str, Callable[[bytes], bytes]] = {
    "zstd 3, bare packets": zstandard.ZstdCompressor(level=3).compress,
    "zstd 19, bare packets": zstandard.ZstdCompressor(level=19).compress,
    "xz 6, bare packets": lambda data: lzma.compress(data, preset=6),
}
ALONE = {"framing": split.FRAMING, "key_interval": 1}
"""Settings of single scans: each is a whole revolution and refers to no other."""
ALONE_SAID = f"framing={split.FRAMING} key_interval=1"
PLANES = ("range", "mask", "geometry", "intensity", "azimuth", "side", "header", "total")
REST = ("ratio", "kbit/s", "RMSE mm", "max mm", "packets")
HEAD = f"| codec | {' | '.join(PLANES + REST)} |\n|---|{'---:|' * len(PLANES + REST)}"


def _row(result: dict[str, Any]) -> str:
    cells = [
        f"`{label(result).replace(f' framing={FRAMING}', '').replace(' key_interval=1', '')}`",
        *(f"{result['bits_per_point'][name]:.3f}" for name in PLANES),
        f"{result['ratio']:.2f}",
        f"{result['kbps_at_10hz']:,.0f}",
        f"{1e3 * (result['rmse_m'] or 0):.2f}",
        f"{1e3 * (result['max_error_m'] or 0):.0f}",
        "identical" if result["packets_identical"] else "differ",
    ]
    return "| " + " | ".join(cells) + " |"


def _peer_rows(spec: str, calibration: Any, limit: int | None, framing: str) -> Iterator[str]:
    with open_source(spec, calibration=calibration) as source:
        payloads: list[bytes] = []

        def remembered() -> Iterator[Any]:
            for packet in source.packets():
                if not packet.position:
                    payloads.append(packet.payload)
                yield packet

        frames = list(islice(frames_of(remembered(), source.sensor, framing), limit))
    points, groups, at = sum(frame.points for frame in frames), [], 0
    for frame in frames:
        count = frame.side.packets if frame.side else 0
        groups.append(b"".join(payloads[at : at + count]))
        at += count
    size = sum(map(len, groups))
    for name, compress in PEERS.items():
        coded = sum(len(compress(group)) for group in groups)
        rate = coded * 8 / at * 348 * 10 / 1000
        blank = " | ".join(["-"] * 7)
        yield (
            f"| {name} | {blank} | {coded * 8 / points:.3f} | {size / coded:.2f} | {rate:,.0f} | 0.00 | 0 | identical |"
        )


def _scene(scene: str, frames: int | None) -> str | None:
    """One scene's heading and table; None if its data is not here."""
    title, name, calibration = SCENES[scene]
    spec = name if name.startswith("sim:") else str(DATA / name)
    if not name.startswith("sim:") and not (DATA / name).exists():
        print(f"not measured: {title}, no {name} in LIDARCODEC_DATA", file=sys.stderr)
        return None
    found = None if calibration is None else DATA / calibration
    alone = ALONE if scene == split.NAME else {}
    settings = [
        one.changed(**({"framing": FRAMING} | alone))
        for one in SETTINGS
        if not (alone and "motion" in one.codec_settings)
    ]
    rows = [bench(spec, one, frames=frames, calibration=found) for one in settings]
    first = rows[0]
    origin = first["calibration"]
    about = (
        f"`{name}`, {first['frames']} frames, {first['points_per_frame']:,.0f} points a frame, "
        f"calibration {origin['origin']} `{origin['hash']}`, "
        f"all with `{ALONE_SAID if alone else f'framing={FRAMING}'}`."
    )
    return "\n".join(
        [
            f"### {title}\n\n{about}\n",
            HEAD,
            *map(_row, rows),
            *_peer_rows(spec, found, frames, str(alone.get("framing", FRAMING))),
        ]
    )


def main() -> int:
    """Measure, and print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.tables", description=__doc__)
    parser.add_argument("--frames", type=int, default=None, help="of each scene, for a quick look")
    parser.add_argument("--scenes", default=",".join(SCENES), help="of " + ", ".join(SCENES))
    parser.add_argument("--save", action="store_true", help="into benchmarks/results/codecs")
    chosen = parser.parse_args()
    for scene in chosen.scenes.split(","):
        part = _scene(scene, chosen.frames)
        if part is not None:
            print(part, flush=True)
            if chosen.save:
                results.save(f"codecs/{scene}", part)
    return 0


if __name__ == "__main__":
    sys.exit(main())

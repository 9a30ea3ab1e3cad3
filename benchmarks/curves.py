"""Error against bitrate of every codec, and what peers reach: measured once, drawn as often as wanted.

    python -m benchmarks.curves --measure [--scene NAME]...    writes benchmarks/results/curves.json
    python -m benchmarks.curves --draw docs                    pictures of what stands there

One scene by hand: `lidarcodec bench SOURCE --codec pcodec,predictive,png,jxl,jpeg,h264 --curve
--set framing=packets --set intensity=off --skip 40 --frames 48 --json --plot curves.png`, and the peers with
`--peers --metrics all`.

Frames of a scene follow each other, because `jpeg-layered` and the video codecs live on that: 48 are six groups of
eight, and hold one key frame of the 50 that video has by default.
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from benchmarks.curve_tables import draw, text
from benchmarks.results import FOLDER, here
from benchmarks.scenes import DATA, FRAMING
from benchmarks.tables import KITTI
from lidarcodec.commands import simulate
from lidarcodec.commands.bench.curve import curve, knob_of
from lidarcodec.commands.settings import one_setting, sweep
from lidarcodec.evaluation.bench import bench
from lidarcodec.evaluation.peers import table as peers
from lidarcodec.evaluation.peers.run import bench_peer

RESULTS = FOLDER / "curves.json"
CODECS = "pcodec,predictive,png,jxl,jpeg,jpeg-layered,h264,h264-log"
FRAMED = f"framing={FRAMING}"
PEER_FRAMES = 4
FIVE_CM = {
    "pcodec": "max_error_m=0.086",
    "predictive": "max_error_m=0.086",
    "jpeg": "quality=79",
    "h264": "crf=0",
    "h264-log": "crf=1",
}
"""Settings with an RMSE of about 5 cm, whose errors are shown by range."""


@dataclass(frozen=True)
class Run:
    """Frames of a drive that follow each other. about: what the car does; peers: whether they are measured, too."""

    title: str
    source: str
    about: str
    skip: int = 0
    frames: int = 48
    peers: bool = False

    @property
    def spec(self) -> str:
        """The source as `open_source` takes it; a capture that lies expanded beside the packed one is quicker."""
        if self.source.startswith("sim:"):
            return self.source
        plain = DATA / self.source.removesuffix(".xz")
        return str(plain if plain.exists() else DATA / self.source)

    @property
    def calibration(self) -> Path | None:
        """KITTI's for KITTI."""
        return None if self.source.startswith("sim:") else DATA / KITTI


RUNS = {
    "0005": Run("KITTI 0005 (test)", "kitti_0005.pcap.xz", "drives and turns in a town, 4.4 m/s", 40, peers=True),
    "0013": Run("KITTI 0013", "kitti_0013_f052-107.pcap.xz", "drives past much vegetation, 12 m/s", 8, peers=True),
    "sfnd": Run("KITTI sfnd", "kitti_sfnd_f000-049.pcap.xz", "brakes and stands, 0.8 m/s on average", 2),
    "0006": Run("KITTI tracking 0006", "kitti_tracking0006_f000-010.pcap.xz", "stands", 0, 8),
    "city": Run("simulated town", "sim:city?seed=1&packets=20880", "drives; simulated, no measurement of a sensor", 8),
}


def _kept(result: dict[str, Any], more: tuple[str, ...] = ()) -> dict[str, Any]:
    """What tables and pictures need of a result."""
    names = ("codec", "kbps_at_10hz", "rmse_m", "max_error_m", "psnr_db", *more)
    settings = result["settings"]
    if peers.is_peer(result["codec"]):
        knob = {name: value for name, value in settings.items() if name != "holds"}
    else:
        turned = knob_of(result["codec"])
        knob = {turned: (settings["codec_settings"] | settings)[turned]}
    bits = {name: result["bits_per_point"][name] for name in ("geometry", "total")}
    return {"knob": knob, "bits_per_point": bits} | {name: result[name] for name in names}


MORE = ("chamfer_m", "point_to_plane_psnr_db", "d1_psnr_db", "d2_psnr_db", "version")


def measure(run: Run) -> dict[str, Any]:
    """Everything of one scene."""
    if run.source.startswith("sim:"):
        with TemporaryDirectory() as folder:  # simulated once, not for every point
            capture = Path(folder) / "simulated.pcap"
            simulate.run(run.source, capture, None)
            return _measured(run, str(capture))
    return _measured(run, run.spec)


def _measured(run: Run, spec: str) -> dict[str, Any]:
    common: dict[str, Any] = {"skip": run.skip, "calibration": run.calibration}
    found = []
    for settings in curve(CODECS, [FRAMED, "intensity=off"]):
        result = bench(spec, settings, frames=run.frames, **common)
        found.append(_kept(result))
        print(run.title, settings.codec, found[-1]["knob"], f"{1e3 * (result['rmse_m'] or 0):.1f} mm",
              f"{result['bits_per_point']['geometry']:.3f} bits", file=sys.stderr, flush=True)  # fmt: skip
    out = {"title": run.title, "about": run.about, "source": run.source, "skip": run.skip, "frames": run.frames}
    out |= {"points_per_frame": result["points_per_frame"], "results": found, "peers": [], "ours": [], "by_range": []}
    if run.peers:
        some: dict[str, Any] = common | {"frames": PEER_FRAMES, "metrics": "all"}
        for settings in sweep("pcodec,predictive,jxl", [FRAMED, "intensity=off", "max_error_m=0,0.01,0.05,0.2"]):
            out["ours"].append(_kept(bench(spec, settings, **some), MORE))
        for codec, pair in FIVE_CM.items():
            result = bench(
                spec, one_setting(codec, [FRAMED, "intensity=off", pair]), **common, frames=run.frames, metrics="all"
            )
            out["by_range"].append(_kept(result, ("range_errors",)))
        for name in peers.names():
            for value in peers.peer(name).values:
                out["peers"].append(_kept(bench_peer(spec, name, value, framing=FRAMING, **some), MORE))
                print(run.title, name, value, file=sys.stderr, flush=True)
    return out


def main() -> int:
    """Measure, draw, or both."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.curves", description=__doc__)
    parser.add_argument(
        "--measure", action="store_true", help="anew, instead of what benchmarks/results/curves.json holds"
    )
    parser.add_argument("--scene", action="append", choices=RUNS, default=[], help="only this one; repeatable")
    parser.add_argument("--draw", type=Path, default=None, metavar="FOLDER", help="pictures into this folder")
    parser.add_argument(
        "--results", type=Path, default=RESULTS, help="another file than benchmarks/results/curves.json"
    )
    chosen = parser.parse_args()
    results = chosen.results
    known: dict[str, Any] = json.loads(results.read_text())["scenes"] if results.exists() else {}
    if chosen.measure:
        for name in chosen.scene or RUNS:
            known[name] = measure(RUNS[name])
            scenes = {name: known[name] for name in RUNS if name in known}
            results.write_text(_one_result_a_line({**here(), "scenes": scenes}))
    print(text(known))
    if chosen.draw is not None:
        draw(known, chosen.draw)
    return 0


def _one_result_a_line(known: dict[str, Any]) -> str:
    """JSON that a diff can be read of."""
    return json.dumps(known, separators=(",", ":")).replace('{"knob"', '\n{"knob"') + "\n"


if __name__ == "__main__":
    sys.exit(main())

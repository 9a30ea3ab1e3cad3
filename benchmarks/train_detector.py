"""Trains the detector of `lidarcodec evaluate detection` on simulated drives, or begins with its weights on KITTI's.

    python -m benchmarks.train_detector --out detector.pt --weights detector.npz [--jobs 2]
    python -m benchmarks.train_detector --labelled --begin detector.pt --out kitti.pt --weights kitti.npz

Simulated drives are those of SIMULATED, with seeds that no benchmark measures by. Labelled ones are drives 0001, 0013
and 0006 of KITTI, beside a few simulated ones; drive 0005 is for testing only. An existing checkpoint is continued.
"""

from __future__ import annotations

import argparse
import sys
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Final

from benchmarks.scenes import DATA
from lidarcodec.evaluation.detection.detector.network import LAYERS
from lidarcodec.evaluation.detection.labels import read_labels
from lidarcodec.training.detector_data import Example, examples_of
from lidarcodec.training.runs import load_checkpoint
from lidarcodec.training.train_detector import DetectorRun, train_detector
from lidarcodec.untrusted.network_weights import packed

SCENES: Final = {"city": 150, "street": 15, "road": 15, "motorway": 15, "bend": 15}
"""Drives of each scene: seeds from FIRST_SEED on."""
FIRST_SEED: Final = 101
FRAMES: Final = 20
EVERY: Final = 2
"""Frames a drive, and which of them are taken: what is near in time is alike."""
LABELS: Final = DATA / "sensors" / "labels"
CALIBRATION: Final = DATA / "kitti_hdl64e_s2_recovered_db.xml"
LABELLED: Final[tuple[tuple[str, tuple[str, ...], int], ...]] = (
    ("kitti_0001_f000-089.pcap.xz", ("drive_0001_tracklet_labels.xml",), 0),
    ("kitti_0013_f052-107.pcap.xz", ("0003.txt", "calib_0000.txt"), 51),
    ("kitti_tracking0006_f000-010.pcap.xz", ("0006.txt", "calib_0000.txt"), 0),
)
"""Drive, its labels, and the number of those of its first frame: where most returns lie in the boxes."""
BESIDE: Final = 20
"""Simulated drives that labelled ones are trained beside: KITTI's have hardly a person."""


def simulated(spec: str) -> list[Example]:
    """Every EVERY-th frame of a drive."""
    return list(examples_of(spec))[::EVERY]


def specs(most: int | None = None) -> list[str]:
    """The simulated drives, of all scenes in turn."""
    found = [
        f"sim:{scene}?seed={FIRST_SEED + number}&skip={53 * (number % 17)}&frames={FRAMES}"
        for number in range(max(SCENES.values()))
        for scene, count in SCENES.items()
        if number < count
    ]
    return found[:most]


def main() -> None:
    """Make the examples and train."""
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    words.add_argument("--out", type=Path, required=True, help="checkpoint; an existing one is continued")
    words.add_argument("--weights", type=Path, required=True, help="file of weights to write")
    words.add_argument("--labelled", action="store_true", help="KITTI's drives")
    words.add_argument("--begin", type=Path, help="checkpoint to begin with")
    words.add_argument("--drives", type=int, help="simulated drives to take, of all scenes in turn")
    words.add_argument("--steps", type=int, default=8000)
    words.add_argument("--batch", type=int, default=32)
    words.add_argument("--rate", type=float, default=3e-3)
    words.add_argument("--seconds", type=float, help="stop after this time of training")
    words.add_argument("--device", default="auto")
    words.add_argument("--jobs", type=int, default=1, help="processes that make examples")
    asked = words.parse_args()
    examples: list[Example] = []
    with ProcessPoolExecutor(asked.jobs, mp_context=get_context("spawn")) as pool:
        for made in pool.map(simulated, specs(asked.drives or (BESIDE if asked.labelled else None))):
            examples += made
    for drive, labels, first in LABELLED if asked.labelled else ():
        known = read_labels(*(LABELS / name for name in labels))
        examples += examples_of(DATA / drive, known, first_label=first, calibration=CALIBRATION)
    print(len(examples), "examples", file=sys.stderr, flush=True)
    run = DetectorRun(steps=asked.steps, batch=asked.batch, rate=asked.rate)

    def tick(step: int, loss: float) -> None:
        if step % 200 == 0:
            print(step, round(loss, 4), file=sys.stderr, flush=True)

    net = train_detector(examples, asked.out, run, asked.device, tick, asked.seconds, asked.begin)
    state = load_checkpoint(asked.out, None)
    about: dict[str, Any] = {
        "trained_on": ("drives 0001, 0013 and 0006 of KITTI, and " if asked.labelled else "") + "simulated drives",
        "licence": "CC BY-NC-SA 3.0" if asked.labelled else "Apache-2.0",
        "steps": state.step if state else 0,
        "seconds": round(state.seconds) if state else 0,
    }
    asked.weights.write_bytes(packed(net.folded(), about, LAYERS))


if __name__ == "__main__":
    main()

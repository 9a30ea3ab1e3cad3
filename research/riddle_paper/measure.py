"""What predictors reach on turns they have not seen: how often they are right, and what the residuals cost."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from lidarcodec import entropy
from lidarcodec.motion.warp import RangeHistory
from lidarcodec.ranges.image.canvas import level_offsets
from research.riddle_paper.baselines import BASELINES
from research.riddle_paper.coding import Predictor, decode_image, encode_image
from research.riddle_paper.context import ContextReader
from research.riddle_paper.data import Scan
from research.riddle_paper.images import PaperImage, image_of, ranges_of
from research.riddle_paper.residuals import Residuals, encode_sparse, encode_varint, entropy_bits

NEAR_M = 0.1
"""The paper counts a prediction as right within this."""


@dataclass(frozen=True)
class Learned:
    """A trained predictor and how many points of the scan before it takes."""

    predictor: Predictor
    temporal: int


@dataclass
class Tally:
    """Sums over frames for one predictor at one step."""

    returns: int = 0
    right: int = 0
    near: int = 0
    bits: dict[str, float] = field(default_factory=dict)
    seconds: float = 0.0

    def add(self, residuals: Residuals, step_m: float, bits: Mapping[str, float], seconds: float) -> None:
        """Takes the residuals of more returns, and what they cost by each coder."""
        self.returns += len(residuals)
        self.right += int(np.count_nonzero(residuals == 0))
        self.near += int(np.count_nonzero(np.abs(residuals) * step_m <= NEAR_M + 1e-9))
        self.seconds += seconds
        for name, value in bits.items():
            self.bits[name] = self.bits.get(name, 0.0) + value

    def row(self) -> dict[str, Any]:
        """As shares, and bits a return."""
        count = max(self.returns, 1)
        return {
            "returns": self.returns,
            "right_cell": self.right / count,
            "within_0.1_m": self.near / count,
            "bits": {name: value / count for name, value in self.bits.items()},
            "seconds": self.seconds,
        }


def whole_frames(
    scans: Sequence[Scan], nets: Mapping[str, Learned], step: int, tell: Callable[[str], None] = lambda _: None
) -> dict[str, dict[str, Any]]:
    """By predictor: every return of every scan, coded by both coders."""
    tallies = {name: Tally() for name in (*BASELINES, *nets)}
    for number, scan in enumerate(scans):
        image = image_of(scan.frame, step)
        for name, tally in tallies.items():
            started = time.monotonic()
            if name in nets:
                guess = nets[name].predictor.predict_all(image, scan.points(step, nets[name].temporal))
            else:
                guess = BASELINES[name](image.cells, image.valid)
            left = (image.cells - guess)[image.valid].astype(np.int64)
            cost = {"sparse": 8.0 * len(encode_sparse(left)), "varint": 8.0 * len(encode_varint(left))}
            tally.add(left, image.step_m, cost | {"entropy": entropy_bits(left)}, time.monotonic() - started)
        tell(f"step {step}: {number + 1} of {len(scans)} whole frames")
    return {name: tally.row() for name, tally in tallies.items()}


def drawn_returns(
    scans: Sequence[Scan], nets: Mapping[str, Learned], step: int, count: int, seed: int = 1
) -> dict[str, dict[str, Any]]:
    """By predictor: `count` returns drawn at random from each scan; their bits are the entropy of all residuals."""
    left: dict[str, list[Residuals]] = {name: [] for name in (*BASELINES, *nets)}
    for number, scan in enumerate(scans):
        image = image_of(scan.frame, step)
        rows, columns = np.nonzero(image.valid)
        rng = np.random.default_rng([seed, number])
        drawn = rng.choice(len(rows), min(count, len(rows)), replace=False)
        some = rows[drawn], columns[drawn]
        for name, parts in left.items():
            guess = _drawn(nets[name], scan, image, some) if name in nets else (
                BASELINES[name](image.cells, image.valid)[some])  # fmt: skip
            parts.append((image.cells[some] - guess).astype(np.int64))
    rows_by_name = {}
    for name, parts in left.items():
        every, tally = np.concatenate([np.zeros(0, np.int64), *parts]), Tally()
        tally.add(every, step * 0.002, {"entropy": entropy_bits(every)}, 0.0)
        rows_by_name[name] = tally.row()
    return rows_by_name


def _drawn(net: Learned, scan: Scan, image: PaperImage, some: tuple[Any, Any]) -> Any:
    reader = ContextReader(image, scan.points(image.step, net.temporal))
    parts = [
        net.predictor.predict(reader.read(some[0][at : at + 128], some[1][at : at + 128]), image)
        for at in range(0, len(some[0]), 128)
    ]
    return np.concatenate([np.zeros(0, np.int32), *parts])


def comes_back(scan: Scan, net: Learned, step: int) -> dict[str, Any]:
    """Encodes a scan, decodes it from bytes, mask and directions alone, and compares.

    bits: a return; largest_error_m: against what was measured; seconds: of both
    """
    started = time.monotonic()
    image = image_of(scan.frame, step)
    points = scan.points(step, net.temporal)
    data = encode_image(image, net.predictor, points)
    unknown = image.with_cells(np.zeros_like(image.cells))
    came = ranges_of(decode_image(data, unknown, net.predictor, points), scan.frame)
    valid = scan.frame.valid
    off = np.abs(came.astype(np.int64) - scan.frame.range)[valid]
    return {
        "bits": 8 * len(data) / max(int(valid.sum()), 1),
        "largest_error_m": float(off.max(initial=0)) * 0.002,
        "seconds": time.monotonic() - started,
    }


def ours(scans: Sequence[Scan], step: int) -> dict[str, dict[str, Any]]:
    """`predictive` on the same scans, each as a key frame, and with the scan before; and the mask, which all need.

    step: odd
    """
    alone, after = Tally(), Tally()
    masks = {"mask": 0.0, "mask, scan before": 0.0}
    for scan in scans:
        frame, levels = scan.frame, level_offsets(scan.frame.sensor)
        given = (frame.range_u16, frame.valid, frame.fired, frame.sensor, step, levels)
        size = len(entropy.PredictiveCoder().encode(*given))
        alone.returns, alone.bits = alone.returns + frame.points, {"range": alone.bits.get("range", 0) + 8 * size}
        masks["mask"] += 8 * len(entropy.encode_mask(frame.valid, frame.fired, frame.sensor))
        if scan.earlier is None or scan.motion is None:
            continue
        before = scan.earlier
        coder, seen = entropy.PredictiveCoder(), RangeHistory()
        coder.encode(before.range_u16, before.valid, before.fired, before.sensor, step, levels)
        seen.remember(ranges_of(image_of(before, step), before), before.azimuth, before.fired, before.sensor)
        expected = seen.expected(scan.motion, frame.azimuth, frame.fired, frame.sensor)
        size = len(coder.encode(*given, expected=expected))
        after.returns, after.bits = after.returns + frame.points, {"range": after.bits.get("range", 0) + 8 * size}
        masks["mask, scan before"] += 8 * len(
            entropy.encode_mask(frame.valid, frame.fired, frame.sensor, before.valid)
        )  # fmt: skip
    rows = {"predictive": alone, "predictive, scan before": after}
    found = {name: {"returns": t.returns, "bits": t.row()["bits"]} for name, t in rows.items()}
    found["mask"] = {"returns": alone.returns, "bits": {"mask": masks["mask"] / max(alone.returns, 1)}}
    before_bits = {"mask": masks["mask, scan before"] / max(after.returns, 1)}
    return found | {"mask, scan before": {"returns": after.returns, "bits": before_bits}}

"""Training of PocoNet on annotated drives as in the paper: a siamese pair with shared weights, Adam, 5 % decay an
epoch.

Each step uses the scans for its number, and two random samplings of each scan. The loss is the label loss of the first
branch (equation 6: weighted cross entropy of three classes), plus the distance of both codewords (equation 7: the
codeword should not depend on the sampling).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from lidarcodec.errors import SettingsError, SourceError
from lidarcodec.frame import Frame
from lidarcodec.training.annotation_folder import Labels
from lidarcodec.training.identity import digest_of
from lidarcodec.training.nets.poconet import CLASSES, PocoNet
from lidarcodec.training.poco_data import CPU_POINTS, LEAST_POINTS, PAPER_POINTS, PocoScan, levels_of, poco_scan
from lidarcodec.training.runs import (
    Checkpoint,
    choose_device,
    load_checkpoint,
    save_checkpoint,
    seed_torch,
    set_rate,
    step_rng,
)
from lidarcodec.training.score_data import labelled
from lidarcodec.training.score_metrics import Agreement

SAVE_SECONDS: Final = 120.0
LOW, HIGH, GROUND = range(CLASSES)


@dataclass(frozen=True)
class PocoRun:
    """Training options of PocoNet.

    points: points of a scan; None: 4096 * 30 on a GPU, otherwise 8192;  decay: of the learning rate in an epoch
    codeword_weight: lambda of equation 7; the paper does not give it
    """

    seed: int = 1
    epochs: int = 30
    batch: int = 1
    points: int | None = None
    rate: float = 1e-3
    decay: float = 0.95
    codeword_weight: float = 0.1

    def __post_init__(self) -> None:
        if self.epochs < 1 or self.batch < 1 or (self.points is not None and self.points < LEAST_POINTS):
            raise SettingsError(f"epochs and batch must be at least 1, points at least {LEAST_POINTS}")

    def on(self, device: torch.device) -> dict[str, Any]:
        """The settings of the run, with the number of points for this device."""
        points = self.points or (PAPER_POINTS if device.type == "cuda" else CPU_POINTS)
        return asdict(self) | {"points": points}


def train_poconet(
    drives: Sequence[Path], out: Path, run: PocoRun, device: str = "auto",
    tick: Callable[[int, float, float], None] = lambda step, loss, codewords: None,
    every: int = 1, seconds: float | None = None,
) -> PocoNet:  # fmt: skip
    """Train the network. out: file of the checkpoint; an existing one is continued

    tick(step, label loss, codeword loss): called after each step;  every: use every so many labelled frames
    seconds: stop with a checkpoint after this time;  Raises SettingsError, SourceError.
    """
    target = choose_device(device)
    settings = run.on(target)
    frames = [pair for pair in labelled(drives, every) if pair[0].points]
    if not frames:
        raise SourceError("the drives have no labelled frame to train on")
    parts = (part for frame, labels in frames for part in (frame.range, labels.labels))
    settings = settings | {"examples": digest_of(parts)}
    weights = class_weights(frames).to(target)
    seed_torch(run.seed)
    net: PocoNet = PocoNet().to(target)
    optimiser = torch.optim.Adam(net.parameters(), run.rate)
    state = load_checkpoint(out, target) or Checkpoint(0, settings, {}, {})
    state.require(settings)
    if state.step:
        net.load_state_dict(state.model)
        optimiser.load_state_dict(state.optimiser)
    an_epoch = -(-len(frames) // run.batch)
    steps = an_epoch * run.epochs
    began = saved = time.monotonic()
    before, losses = state.seconds, []
    net.train()
    for step in range(state.step, steps):
        epoch, place = divmod(step, an_epoch)
        set_rate(optimiser, run.rate * run.decay**epoch)
        order = step_rng(run.seed, epoch, 1).permutation(len(frames))
        chosen = [frames[int(k)] for k in order[place * run.batch : (place + 1) * run.batch]]
        label, codewords = _losses(net, chosen, settings["points"], step_rng(run.seed, step), weights, run.seed, step)
        optimiser.zero_grad()
        (label + run.codeword_weight * codewords).backward()
        optimiser.step()
        losses.append((float(label.detach()), float(codewords.detach())))
        tick(step, *losses[-1])
        now = time.monotonic()
        state.step, state.seconds = step + 1, before + now - began
        late = seconds is not None and now - began > seconds
        if now - saved > SAVE_SECONDS or state.step == steps or late:
            state.model, state.optimiser = net.state_dict(), optimiser.state_dict()
            means = [round(float(mean), 6) for mean in np.mean(losses, axis=0)]
            state.log.append({"step": state.step, "label": means[0], "codewords": means[1]})
            save_checkpoint(out, state)
            saved, losses = now, []
        if late:
            break
    net.eval()
    return net


def class_weights(frames: Sequence[tuple[Frame, Labels]]) -> Tensor:
    """(3,) 1 / (share + 0.02) for low, high and ground: the class weights of RandLA-Net."""
    counts = sum((np.bincount(truth.labels.ravel(), minlength=4)[1:] for _, truth in frames), np.zeros(CLASSES))
    return torch.tensor(1 / (counts / max(counts.sum(), 1) + 0.02), dtype=torch.float32)


def _losses(
    net: PocoNet, frames: Sequence[tuple[Frame, Labels]], points: int, rng: np.random.Generator, weights: Tensor,
    seed: int, step: int,
) -> tuple[Tensor, Tensor]:  # fmt: skip
    """Equation 6 for the first branch, and the mean squared difference of both codewords."""
    scans = [scan for frame, truth in frames if (scan := poco_scan(frame, truth, points, rng)) is not None]
    seed_torch(seed, step)  # for the dropout
    logits, first = _applied(net, scans, rng, weights.device)
    second = _applied(net, scans, rng, weights.device)[1]
    labels = torch.from_numpy(np.stack([scan.labels for scan in scans])).to(weights.device)
    label: Tensor = functional.cross_entropy(logits, labels, weight=weights)
    return label, functional.mse_loss(first, second)


def _applied(
    net: PocoNet, scans: Sequence[PocoScan], rng: np.random.Generator, device: torch.device
) -> tuple[Tensor, Tensor]:
    features = torch.from_numpy(np.stack([scan.features.T for scan in scans])).to(device)
    logits, codeword = net(features, *levels_of(scans, rng, device))
    return logits, codeword


def poconet_logits(net: PocoNet, frame: Frame, points: int, rng: np.random.Generator) -> Any:
    """(3, N) float32 logits low, high, ground of the frame's returns in the order of its cloud, from one branch."""
    scan = poco_scan(frame, None, points, rng)
    if scan is None:
        return np.empty((CLASSES, 0), np.float32)
    with torch.no_grad():
        logits = _applied(net, [scan], rng, next(net.parameters()).device)[0][0].cpu().numpy()
    return logits[:, scan.nearest]


def measure_poconet(net: PocoNet, drives: Sequence[Path], points: int, every: int = 1, seed: int = 1) -> dict[str, Any]:
    """Results of `Agreement` for a network on annotated drives. Raises SourceError."""
    found = Agreement()
    for k, (frame, truth) in enumerate(labelled(drives, every)):
        logits = poconet_logits(net, frame, points, np.random.default_rng([seed, k]))
        labels, counts = truth.labels.T[frame.valid.T], truth.counts.T[frame.valid.T]
        high = logits[HIGH] - np.logaddexp(logits[LOW], logits[GROUND])
        found.add(high, logits.argmax(axis=0) + 1, labels, counts, high)
    return found.result()

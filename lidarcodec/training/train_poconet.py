"""Training of PocoNet on annotated drives as in the paper: a siamese pair with shared weights, Adam, 5 % decay an
epoch.

Each step uses the scans for its number, and two random samplings of each scan. The loss is the label loss of the first
branch (equation 6: weighted cross entropy of three classes), plus the distance of both codewords (equation 7: the
codeword should not depend on the sampling).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from lidarcodec.errors import SettingsError, SourceError
from lidarcodec.frame import Frame
from lidarcodec.training.annotation_folder import AnnotationFolder
from lidarcodec.training.curve import Clock, Length, rate_by_clock, write_curve
from lidarcodec.training.identity import digest_of
from lidarcodec.training.nets.poconet import CLASSES, PocoNet
from lidarcodec.training.poco_data import (
    CPU_POINTS,
    LEAST_POINTS,
    PAPER_POINTS,
    PocoReturns,
    PocoScan,
    lent,
    levels_of,
    poco_returns,
    poco_scan,
)
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
MEASURE_SECONDS: Final = 600.0
VALIDATED: Final = 12
"""Labelled frames of a drive for the learning curve."""
LOW, HIGH, GROUND = range(CLASSES)


@dataclass(frozen=True)
class PocoRun:
    """Training options of PocoNet.

    points: points of a scan; None: 4096 * 30 on a GPU, otherwise 8192;  decay: of the learning rate in an epoch
    codeword_weight: lambda of equation 7; the paper does not give it
    minutes: of training, instead of epochs; the rate then goes by the clock (`curve`)
    """

    seed: int = 1
    epochs: int = 30
    batch: int = 1
    points: int | None = None
    rate: float = 1e-3
    decay: float = 0.95
    codeword_weight: float = 0.1
    minutes: float | None = None

    def __post_init__(self) -> None:
        if self.epochs < 1 or self.batch < 1 or (self.points is not None and self.points < LEAST_POINTS):
            raise SettingsError(f"epochs and batch must be at least 1, points at least {LEAST_POINTS}")
        if self.minutes is not None and not 0 < self.minutes < math.inf:
            raise SettingsError(f"{self.minutes} minutes of training: more than 0 are needed", "minutes")

    def on(self, device: torch.device) -> dict[str, Any]:
        """The settings of the run, with the number of points for this device."""
        points = self.points or (PAPER_POINTS if device.type == "cuda" else CPU_POINTS)
        return asdict(self) | {"points": points}

    def rate_at(self, step: int, epoch: int, seconds: float) -> float:
        """The learning rate of a step."""
        if self.minutes is None:
            return self.rate * self.decay**epoch
        return rate_by_clock(step, Length(minutes=self.minutes).done(step, seconds), peak=self.rate)


def train_poconet(
    drives: Sequence[Path], out: Path, run: PocoRun, device: str = "auto",
    tick: Callable[[int, float, float], None] = lambda step, loss, codewords: None,
    every: int = 1, seconds: float | None = None,
    validate: Sequence[Path] = (), measure_seconds: float = MEASURE_SECONDS,
) -> PocoNet:  # fmt: skip
    """Train the network. out: file of the checkpoint; an existing one is continued

    tick(step, label loss, codeword loss): called after each step;  every: use every so many labelled frames
    seconds: stop with a checkpoint after this time
    validate: drives to measure on every `measure_seconds` and at the end, with VALIDATED frames of each. The network
    with the best mean precision on these frames is kept beside the checkpoint (`best_of`) and returned.
    The learning curve is written to `curve_of`.
    Raises SettingsError, SourceError.
    """
    target = choose_device(device)
    settings = run.on(target)
    frames = [poco_returns(*pair) for pair in labelled(drives, every) if pair[0].points]
    if not frames:
        raise SourceError("the drives have no labelled frame to train on")
    settings = settings | {"examples": digest_of(part for returns in frames for part in returns)}
    weights = class_weights(frames).to(target)
    seed_torch(run.seed)
    net: PocoNet = PocoNet().to(target)
    optimiser = torch.optim.Adam(net.parameters(), run.rate)
    state = load_checkpoint(out, target) or Checkpoint(0, settings, {}, {})
    state.require(settings, may_differ=frozenset({"minutes"}))
    state.settings = settings
    if state.step:
        net.load_state_dict(state.model)
        optimiser.load_state_dict(state.optimiser)
    course = _Course(out, state, run, settings["points"], len(frames), validate)
    before = saved = measured = state.seconds
    losses = list[tuple[float, float]]()
    net.train()
    while not course.over:
        step = state.step
        epoch, place = divmod(step, course.an_epoch)
        set_rate(optimiser, run.rate_at(step, epoch, state.seconds))
        order = step_rng(run.seed, epoch, 1).permutation(len(frames))
        chosen = [frames[int(k)] for k in order[place * run.batch : (place + 1) * run.batch]]
        label, codewords = _losses(net, chosen, settings["points"], step_rng(run.seed, step), weights, run.seed, step)
        optimiser.zero_grad()
        (label + run.codeword_weight * codewords).backward()
        optimiser.step()
        losses.append((float(label.detach()), float(codewords.detach())))
        tick(step, *losses[-1])
        state.step, state.seconds = step + 1, course.clock.seconds
        late = seconds is not None and state.seconds - before > seconds
        due = bool(validate) and (course.over or state.seconds - measured > measure_seconds)
        if state.seconds - saved > SAVE_SECONDS or course.over or late or due:
            course.save(net, optimiser, losses, measure=due)
            saved, losses = state.seconds, []
            measured = saved if due else measured
        if late:
            break
    if validate and (best := load_checkpoint(best_of(out), target)) is not None:
        net.load_state_dict(best.model)
    net.eval()
    return net


class _Course:
    """Writes how a training goes: checkpoints, the best network, and the learning curve."""

    def __init__(
        self, out: Path, state: Checkpoint, run: PocoRun, points: int, frames: int, validate: Sequence[Path]
    ) -> None:
        self._out, self._state, self._points, self._validate = out, state, points, validate
        log: list[dict[str, Any]] = state.log
        self._log = log
        self.an_epoch = -(-frames // run.batch)
        self.clock = Clock(state.seconds, log[-1]["processor"] if log else 0.0)
        self._length = Length(self.an_epoch * run.epochs, run.minutes)

    @property
    def over(self) -> bool:
        """Whether the training has ended."""
        return self._length.over(self._state.step, self._state.seconds)

    def save(
        self, net: PocoNet, optimiser: torch.optim.Optimizer, losses: Sequence[tuple[float, float]], *, measure: bool
    ) -> None:
        """Write all that there is. losses: label and codeword loss of the steps since the last time"""
        state, means = self._state, np.mean(losses, axis=0).tolist()
        row = {"step": state.step, "epochs": state.step / self.an_epoch, "rate": optimiser.param_groups[0]["lr"],
               "label_loss": means[0], "codeword_loss": means[1]}  # fmt: skip
        row["drives"] = _measured(net, self._validate, self._points) if measure else []
        state.seconds = self.clock.seconds
        row |= {"seconds": state.seconds, "processor": self.clock.processor}
        state.model, state.optimiser = net.state_dict(), optimiser.state_dict()
        self._log.append(row)
        if measure and _precision(row) >= max(_precision(other) for other in self._log if _on(other) == _on(row)):
            save_checkpoint(best_of(self._out), state)
        save_checkpoint(self._out, state)
        write_curve(curve_of(self._out), self._log)


def best_of(out: Path) -> Path:
    """The file of the network that was best on the drives to validate on, beside the checkpoint."""
    return out.with_name(f"{out.stem}.best{out.suffix}")


def curve_of(out: Path) -> Path:
    """The file of the learning curve, beside the checkpoint."""
    return out.with_name(f"{out.stem}.curve.csv")


def _measured(net: PocoNet, drives: Sequence[Path], points: int) -> list[dict[str, Any]]:
    net.eval()
    found = []
    for drive in drives:
        every = max(len(AnnotationFolder(drive).labelled()) // VALIDATED, 1)
        found.append({"drive": drive.name} | measure_poconet(net, [drive], points, every))
    net.train()
    return found


def _on(row: Mapping[str, Any]) -> list[tuple[str, int]]:
    """What a measurement is of. Precision on some frames does not compare with precision on others."""
    return [(drive["drive"], drive["frames"]) for drive in row["drives"]]


def _precision(row: Mapping[str, Any]) -> float:
    """Mean over the drives of a measurement; -1 without one."""
    found = [drive["precision"] for drive in row["drives"] if drive["precision"] is not None]
    return sum(found) / len(found) if found else -1.0


def class_weights(frames: Sequence[PocoReturns]) -> Tensor:
    """(3,) 1 / (share + 0.02) for low, high and ground: the class weights of RandLA-Net."""
    counts = sum((np.bincount(returns.labels, minlength=CLASSES) for returns in frames), np.zeros(CLASSES))
    return torch.tensor(1 / (counts / max(counts.sum(), 1) + 0.02), dtype=torch.float32)


def _losses(
    net: PocoNet, frames: Sequence[PocoReturns], points: int, rng: np.random.Generator, weights: Tensor,
    seed: int, step: int,
) -> tuple[Tensor, Tensor]:  # fmt: skip
    """Equation 6 for the first branch, and the mean squared difference of both codewords."""
    scans = [scan for returns in frames if (scan := poco_scan(returns, points, rng)) is not None]
    seed_torch(seed, step)  # for the dropout
    logits, first = net(*_inputs(scans, rng, weights.device))
    second = net.codeword(*_inputs(scans, rng, weights.device)[:-1])
    labels = torch.from_numpy(np.stack([scan.labels for scan in scans])).to(weights.device)
    label: Tensor = functional.cross_entropy(logits, labels, weight=weights)
    return label, functional.mse_loss(first, second)


def _inputs(scans: Sequence[PocoScan], rng: np.random.Generator, device: torch.device) -> tuple[Any, ...]:
    """The arguments of the network, for one draw of the sampling."""
    features = torch.from_numpy(np.stack([scan.features.T for scan in scans])).to(device)
    return features, *levels_of(scans, rng, device)


def poconet_logits(net: PocoNet, frame: Frame, points: int, rng: np.random.Generator) -> Any:
    """(3, N) float32 logits low, high, ground of the frame's returns in the order of its cloud, from one branch."""
    returns = poco_returns(frame, None)
    scan = poco_scan(returns, points, rng)
    if scan is None:
        return np.empty((CLASSES, 0), np.float32)
    with torch.no_grad():
        logits = net(*_inputs([scan], rng, next(net.parameters()).device))[0][0].cpu().numpy()
    return logits[:, lent(scan, returns)]


def measure_poconet(net: PocoNet, drives: Sequence[Path], points: int, every: int = 1, seed: int = 1) -> dict[str, Any]:
    """Results of `Agreement` for a network on annotated drives. Raises SourceError."""
    found = Agreement()
    for k, (frame, truth) in enumerate(labelled(drives, every)):
        logits = poconet_logits(net, frame, points, np.random.default_rng([seed, k]))
        labels, counts = truth.labels.T[frame.valid.T], truth.counts.T[frame.valid.T]
        high = logits[HIGH] - np.logaddexp(logits[LOW], logits[GROUND])
        found.add(high, logits.argmax(axis=0) + 1, labels, counts, high)
    return found.result()

"""Training of RIDDLE's predictor: seeded, with checkpoints, resumable to the very weights of a run without a break."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch

from lidarcodec.errors import SettingsError, SourceError
from lidarcodec.training import runs
from lidarcodec.training.curve import Clock, Length, rate_by_clock, write_curve
from lidarcodec.units import RANGE_STEP_M
from research.riddle_paper import coding, measure
from research.riddle_paper.context import FEATURES, SPATIAL, step_feature
from research.riddle_paper.data import PreparedScans, Samples, Scan
from research.riddle_paper.net import RESIDUAL_UNIT_M, NetShape, RiddlePaper, loss_of, predicted
from research.riddle_paper.residuals import entropy_bits

CHECKPOINT: Final = "checkpoint.pt"
BEST: Final = "best.pt"
"""The network whose residuals were cheapest on scans that were held out."""
CURVE: Final = "curve.csv"
CURVE_STEPS: Final = (11, 51)
"""Quantisation of the learning curve: that of docs/riddle-paper.md."""
CURVE_RETURNS: Final = 1500
"""Drawn from each scan for it."""
EVERY_SECONDS: Final = 600.0
READY: Final = 800
"""Images that stay ready; a quarter of them with points of the scan before, which are four times as large."""
_CHUNK: Final = 64
"""Returns that a CPU works on at once: what they need stays in its cache, which is twice as fast as 1024 together."""
_MOST_GRADIENT: Final = 5.0
"""Norm to which gradients are cut."""
_VALIDATION_STEP: Final = 1 << 30
"""Number of the step that validation draws as: none of the training's."""


@dataclass(frozen=True)
class RunSettings:
    """What a run is asked for.

    temporal:  points of the scan before in a context; 0 is the intra variant, 100 the paper's, 50 its supplement's
    steps:     of the optimiser; batch: returns in each, from `frames` scans; quanta: range steps to quantise to
    minutes:   of training, instead of steps; the learning rate then goes by the clock
    rate:      peak of the learning rate; encoder, decoder: widths of the network
    """

    temporal: int = 0
    steps: int = 4000
    batch: int = 1024
    frames: int = 2
    quanta: tuple[int, ...] = (10, 11, 50, 51)
    rate: float = 2e-3
    seed: int = 1
    encoder: tuple[int, ...] = (32, 64, 128)
    decoder: tuple[int, ...] = (256, 128)
    residual_weight: float = 0.5
    minutes: float | None = None

    def __post_init__(self) -> None:
        limits = {"temporal": (0, 1000), "steps": (1, 10**8), "batch": (1, 1 << 20), "frames": (1, 1 << 10)}
        for name, (least, most) in limits.items():
            if not least <= getattr(self, name) <= most:
                raise SettingsError(f"{name} = {getattr(self, name)}: {least} to {most} are possible", name)
        if not self.quanta or min(self.quanta) < 1:
            raise SettingsError(f"quanta = {self.quanta}: at least one, each at least 1", "quanta")
        if self.minutes is not None and not 0 < self.minutes < math.inf:
            raise SettingsError(f"{self.minutes} minutes of training: more than 0 are needed", "minutes")
        if self.batch < self.frames:
            raise SettingsError(f"a batch of {self.batch} returns from {self.frames} frames", "batch")

    @property
    def shape(self) -> NetShape:
        """The network's."""
        return NetShape(SPATIAL, self.temporal, FEATURES, self.encoder, self.decoder)

    def rate_at(self, step: int, seconds: float) -> float:
        """The learning rate of a step."""
        if self.minutes is None:
            return runs.rate_at(step, self.steps, peak=self.rate)
        return rate_by_clock(step, Length(minutes=self.minutes).done(step, seconds), peak=self.rate)

    def stored(self) -> dict[str, runs.Value]:
        """As a checkpoint keeps them."""
        return {
            name: list(value) if isinstance(value, tuple) else value for name, value in asdict(self).items()
        }  # fmt: skip

    @classmethod
    def restored(cls, values: dict[str, runs.Value]) -> RunSettings:
        """Out of a checkpoint. Raises SourceError if they are not those of such a run."""
        try:
            return cls(**{name: tuple(v) if isinstance(v, list) else v for name, v in values.items()})  # type: ignore[arg-type]
        except TypeError:
            raise SourceError("the checkpoint is not one of RIDDLE's predictor") from None


@dataclass(frozen=True)
class Progress:
    """Where a run stands: steps done of all, loss of the last one, and what was measured if that was due; the share of
    the training that is done, 0 to 1."""

    step: int
    steps: int
    loss: float
    measured: dict[str, runs.Value] | None
    done: float


def train(
    scans: Sequence[Scan],
    held_out: Sequence[Scan],
    settings: RunSettings,
    folder: Path,
    *,
    device: torch.device | None = None,
    until: int | None = None,
    every: int = 250,
    every_seconds: float = EVERY_SECONDS,
    validate: Mapping[str, Sequence[Scan]] | None = None,
    tell: Callable[[Progress], None] | None = None,
) -> RiddlePaper:
    """Trains, or goes on where the checkpoint in `folder` stands, up to step `until` (default: the end).

    A run may be given another number of steps, or of minutes, on the way: from there on the learning rate follows it.
    held_out: scans to measure on, every `every` steps, or every `every_seconds` of a training by the clock. Then the
    checkpoint is written too, and as BEST if no residuals of another were as cheap on them
    validate: scans of drives by name, for the learning curve alone (CURVE)
    Raises SettingsError if the folder holds a run under other settings, or no scan suits the variant.
    """
    device = device or runs.choose_device("cpu")
    scans, held_out = _fit(scans, settings), _fit(held_out, settings)
    if not scans:
        raise SettingsError(
            "nothing to train on: no source has a scan of a whole turn (with a known motion, if temporal)"
        )
    runs.seed_torch(settings.seed)
    net = RiddlePaper(settings.shape)
    net.to(device)
    optimiser = torch.optim.Adam(net.parameters(), lr=settings.rate, betas=(0.9, 0.98))
    state = runs.load_checkpoint(folder / CHECKPOINT, device)
    if state is None:
        state = runs.Checkpoint(0, settings.stored(), {}, {})
    else:
        state.require(settings.stored(), may_differ=frozenset({"steps", "minutes"}))
        state.settings = settings.stored()
        net.load_state_dict(state.model)
        optimiser.load_state_dict(state.optimiser)
    length = Length(settings.steps, settings.minutes)
    log: list[dict[str, Any]] = state.log
    clock = Clock(state.seconds, log[-1]["processor"] if log else 0.0)
    prepared = PreparedScans(scans, settings.temporal, READY // (4 if settings.temporal else 1))
    saved, losses = state.seconds, list[float]()
    while not length.over(state.step, state.seconds) and (until is None or state.step < until):
        rng = runs.step_rng(settings.seed, state.step)
        parts = prepared.batch(settings.quanta, settings.batch, settings.frames, rng)
        runs.set_rate(optimiser, settings.rate_at(state.step, state.seconds))
        loss_now = _learn(net, optimiser, parts, settings, device)
        losses.append(loss_now)
        state.step, state.seconds = state.step + 1, clock.seconds
        due = state.step % every == 0 if settings.minutes is None else state.seconds - saved > every_seconds
        measured: dict[str, Any] | None = None
        if due or length.over(state.step, state.seconds) or state.step == until:
            measured = {"step": state.step, "returns": state.step * settings.batch, "loss": float(np.mean(losses))}
            measured |= {"rate": optimiser.param_groups[0]["lr"]} | _measure(net, held_out, settings, device)
            measured["drives"] = _on_drives(net, validate or {}, settings, device)
            state.seconds = saved = clock.seconds
            measured |= {"seconds": state.seconds, "processor": clock.processor}
            log.append(measured)
            state.model, state.optimiser = net.state_dict(), optimiser.state_dict()
            if held_out and measured["held_out_bits"] <= min(row.get("held_out_bits", math.inf) for row in log):
                runs.save_checkpoint(folder / BEST, state)
            runs.save_checkpoint(folder / CHECKPOINT, state)
            write_curve(folder / CURVE, log)
            losses = []
        if tell:
            done = length.done(state.step, state.seconds)
            tell(Progress(state.step, settings.steps, loss_now, measured, done))
    return net


def _on_drives(
    net: RiddlePaper, drives: Mapping[str, Sequence[Scan]], settings: RunSettings, device: torch.device
) -> list[dict[str, Any]]:
    """What residuals cost on other drives, and how often the network is near, in the steps of docs/riddle-paper.md."""
    found = []
    learned = {"net": measure.Learned(coding.Predictor(net, device), settings.temporal)}
    for name, scans in drives.items():
        for step in CURVE_STEPS:
            rows = measure.drawn_returns(scans, learned, step, CURVE_RETURNS)
            own, plain = rows["net"], rows["previous valid"]
            found.append({"drive": name, "step_m": step * RANGE_STEP_M, "entropy_bits": own["bits"]["entropy"],
                          "previous_valid_entropy_bits": plain["bits"]["entropy"], "within_0.1_m": own["within_0.1_m"],
                          "right_cell": own["right_cell"]})  # fmt: skip
    return found


def load_net(
    folder: Path, device: torch.device | None = None, file: str = CHECKPOINT
) -> tuple[RiddlePaper, runs.Checkpoint]:
    """The predictor that was trained into `folder`, and how that went.

    Raises SourceError if there is none, or it cannot be read.
    """
    state = runs.load_checkpoint(folder / file, device)
    if state is None:
        raise SourceError(f"no {file} in {folder}: train one first")
    net = RiddlePaper(RunSettings.restored(state.settings).shape)
    try:
        net.load_state_dict(state.model)
    except (RuntimeError, AttributeError, TypeError):
        raise SourceError(f"{folder / file} holds another network than it says") from None
    return net, state


def _fit(scans: Sequence[Scan], settings: RunSettings) -> list[Scan]:
    """Those that the variant can use: the temporal one is not trained on scans without one before."""
    return [scan for scan in scans if scan.motion is not None or not settings.temporal]


def _tensors(part: Samples, device: torch.device) -> tuple[torch.Tensor, ...]:
    contexts = part.contexts
    anchors = contexts.anchors_m[np.arange(len(part.anchor)), part.anchor]
    residual = (part.ranges_m - anchors) / np.float32(RESIDUAL_UNIT_M)
    steps = np.full(len(part.anchor), step_feature(part.step), np.float32)
    arrays = (contexts.features, contexts.valid, steps, part.anchor.astype(np.int64), residual, contexts.anchors_m)
    return tuple(torch.from_numpy(array).to(device) for array in (*arrays, part.ranges_m))


def _learn(
    net: RiddlePaper,
    optimiser: torch.optim.Optimizer,
    parts: list[Samples],
    settings: RunSettings,
    device: torch.device,
) -> float:
    """One step on a batch; its mean loss."""
    features, valid, steps, anchor, residual, *_ = (
        torch.cat(tensors) for tensors in zip(*(_tensors(part, device) for part in parts), strict=True)
    )
    count, total = len(anchor), 0.0
    net.train()
    optimiser.zero_grad()
    chunk = _CHUNK if device.type == "cpu" else max(count, 1)
    for at in range(0, count, chunk):
        some = slice(at, at + chunk)
        logits, residuals = net(features[some], valid[some], steps[some])
        loss = loss_of(logits, residuals, anchor[some], residual[some], settings.residual_weight).sum() / count
        loss.backward()
        total += float(loss.detach())
    torch.nn.utils.clip_grad_norm_(net.parameters(), _MOST_GRADIENT)
    optimiser.step()
    return total


def _measure(
    net: RiddlePaper, scans: list[Scan], settings: RunSettings, device: torch.device, count: int = 4096
) -> dict[str, Any]:
    """What the network reaches on scans it has not seen: the same returns every time.

    held_out_bits: entropy of the residuals, a return, each scan in a code of its own; what is to be least
    """
    if not scans:
        return {}
    rng = runs.step_rng(settings.seed, _VALIDATION_STEP)
    parts = PreparedScans(scans, settings.temporal).batch(settings.quanta, count, min(8, len(scans)), rng)
    net.eval()
    right, near, bits, before, held = 0, 0, 0.0, 0.0, 0
    with torch.inference_mode():
        for part in parts:
            tensors, step_m = _tensors(part, device), part.step * RANGE_STEP_M
            left = []
            chunks = zip(*(tensor.split(_CHUNK) for tensor in tensors), strict=True)
            for features, valid, steps, anchor, _, anchors, ranges in chunks:
                logits, residuals = net(features, valid, steps)
                apart = torch.round(ranges / step_m) - torch.round(predicted(logits, residuals, anchors) / step_m)
                right += int((logits.argmax(dim=1) == anchor).sum())
                near += int((apart.abs() * step_m <= 0.1 + 1e-4).sum())
                left.append(apart.to(torch.int64).cpu().numpy())
            bits += entropy_bits(np.concatenate([np.zeros(0, np.int64), *left]))
            before += entropy_bits(np.rint((part.ranges_m - part.contexts.before_m) / step_m).astype(np.int64))
            held += len(part.ranges_m)
    held = max(held, 1)
    return {
        "anchors_right": right / held,
        "within_10_cm": near / held,
        "held_out_bits": bits / held,
        "previous_valid_held_out_bits": before / held,
    }

"""Training of PointNet on maps: which points the programme keeps, by cross entropy.

The order of windows in an epoch depends on its number (`runs.step_rng`), so a resumed run equals an uninterrupted one.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor
from torch.nn import functional

from lidarcodec.errors import SettingsError, SourceError
from lidarcodec.training.identity import digest_of
from lidarcodec.training.nets.map_point_net import MapPointNet
from lidarcodec.training.runs import (
    Checkpoint,
    choose_device,
    load_checkpoint,
    rate_at,
    save_checkpoint,
    seed_torch,
    set_rate,
    step_rng,
)

ROTATION_WEIGHT: Final = 1e-3
"""Of T2's distance from a rotation, as in PointNet."""


WARM_UP: Final = 20


class Windows(NamedTuple):
    """points: (W, N, 3) float32 coordinates in a cube of side 1; kept: (W, N) bool, what the programme keeps"""

    points: npt.NDArray[np.float32]
    kept: npt.NDArray[np.bool_]

    @classmethod
    def of(cls, parts: Sequence[tuple[npt.NDArray[np.float32], npt.NDArray[np.bool_]]]) -> Windows:
        """The windows of several maps."""
        return cls(np.concatenate([part[0] for part in parts]), np.concatenate([part[1] for part in parts]))

    def thinned(self, most: int) -> Windows:
        """At most so many of them, evenly spaced."""
        every = -(-len(self.points) // most)
        return Windows(self.points[::every], self.kept[::every])


@dataclass(frozen=True)
class PointsRun:
    """Training options. batch: windows in a step;  rate: peak"""

    seed: int = 1
    epochs: int = 60
    batch: int = 4
    rate: float = 1e-3

    def __post_init__(self) -> None:
        if self.epochs < 1 or self.batch < 1:
            raise SettingsError("epochs and batch are at least 1")


def train_map_points(
    layers: Mapping[str, tuple[int, int]], learnt: Windows, held_out: Windows, out: Path, run: PointsRun,
    device: str = "auto", tick: Callable[[], None] = lambda: None, seconds: float | None = None,
) -> MapPointNet:  # fmt: skip
    """The network of the best epoch by the loss of what was held out. out: file of the checkpoint; an existing one is
    continued. tick: called after each epoch

    seconds: stop with a checkpoint after this time;  Raises SettingsError, SourceError.
    """
    if not len(learnt.points) or not len(held_out.points):
        raise SourceError("the maps have too few points to train on, or to measure with")
    target = choose_device(device)
    seed_torch(run.seed)
    net = MapPointNet(layers)
    net.begin_at(float(learnt.kept.mean()))
    net.to(target)
    optimiser = torch.optim.AdamW(net.parameters(), run.rate, weight_decay=1e-4)
    settings = asdict(run) | {"windows": digest_of([*learnt, *held_out])}
    state = load_checkpoint(out, target) or Checkpoint(0, settings, {}, {})
    state.require(settings)
    best: dict[str, Tensor] = {}
    if state.step:
        net.load_state_dict(state.model["last"])
        best = state.model["best"]
        optimiser.load_state_dict(state.optimiser)
    began, before = time.monotonic(), state.seconds
    per_epoch = -(-len(learnt.points) // run.batch)
    losses = [one["held_out"] for one in state.log]
    lowest = min((loss for loss in losses if isinstance(loss, float)), default=np.inf)
    for epoch in range(state.step, run.epochs):
        steps = range(epoch * per_epoch, (epoch + 1) * per_epoch)
        rates = (rate_at(step, run.epochs * per_epoch, peak=run.rate, warm_up=WARM_UP) for step in steps)
        loss = _epoch(net, optimiser, learnt, run, step_rng(run.seed, epoch), rates, target)
        measured = loss_on(net, held_out, run.batch)
        if measured < lowest or not best:
            lowest, best = measured, {name: value.detach().clone() for name, value in net.state_dict().items()}
        state.step, state.seconds = epoch + 1, before + time.monotonic() - began
        state.log.append({"epoch": state.step, "loss": round(loss, 5), "held_out": round(measured, 5)})
        state.model, state.optimiser = {"last": net.state_dict(), "best": best}, optimiser.state_dict()
        save_checkpoint(out, state)
        tick()
        if seconds is not None and time.monotonic() - began > seconds:
            break
    net.load_state_dict(best)
    net.eval()
    return net


def _epoch(
    net: MapPointNet, optimiser: torch.optim.Optimizer, learnt: Windows, run: PointsRun, rng: np.random.Generator,
    rates: Iterable[float], device: torch.device,
) -> float:  # fmt: skip
    net.train()
    order, losses = rng.permutation(len(learnt.points)), list[float]()
    for at, rate in zip(range(0, len(order), run.batch), rates, strict=True):
        set_rate(optimiser, rate)
        chosen = order[at : at + run.batch]
        points = _turned(learnt.points[chosen], rng)
        values, off = net(torch.from_numpy(points).to(device))
        wanted = torch.from_numpy(learnt.kept[chosen].astype(np.float32)).to(device)
        loss = functional.binary_cross_entropy_with_logits(values, wanted)
        optimiser.zero_grad()
        (loss + ROTATION_WEIGHT * off).backward()
        optimiser.step()
        losses.append(float(loss.detach()))
    return float(np.mean(losses))


def _turned(points: npt.NDArray[np.float32], rng: np.random.Generator) -> npt.NDArray[np.float32]:
    """Windows turned around the vertical by chance: no street runs east only."""
    angle = rng.uniform(0, 2 * np.pi, len(points))
    turn = np.zeros((len(points), 3, 3))
    turn[:, 0, 0] = turn[:, 1, 1] = np.cos(angle)
    turn[:, 0, 1], turn[:, 1, 0] = -np.sin(angle), np.sin(angle)
    turn[:, 2, 2] = 1
    found = points.astype(np.float64) @ turn
    found -= found.min(axis=1, keepdims=True)
    found /= np.maximum(found.max(axis=(1, 2), keepdims=True), 1e-9)
    return found.astype(np.float32)


def loss_on(net: MapPointNet, windows: Windows, batch: int) -> float:
    """Mean cross entropy."""
    net.eval()
    device, losses = next(net.parameters()).device, list[float]()
    with torch.no_grad():
        for at in range(0, len(windows.points), batch):
            values, _ = net(torch.from_numpy(windows.points[at : at + batch]).to(device))
            wanted = torch.from_numpy(windows.kept[at : at + batch].astype(np.float32)).to(device)
            losses.append(float(functional.binary_cross_entropy_with_logits(values, wanted, reduction="none").sum()))
    return float(np.sum(losses) / windows.kept.size)

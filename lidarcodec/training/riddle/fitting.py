"""Trains one network on samples, with a seed and checkpoints. A resumed run gives the weights of an uninterrupted
one."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final

import numpy as np
import torch

from lidarcodec.errors import SettingsError
from lidarcodec.network.networks import Net
from lidarcodec.network.tiles import SUMS
from lidarcodec.training import runs
from lidarcodec.training.riddle.extraction import LABELS, Rows, row_bytes
from lidarcodec.training.riddle.nets import HIDDEN, RiddleLoss, RiddleNet, mean_bits, values_of
from lidarcodec.training.riddle.tiles import Tiles

_BETAS: Final = (0.9, 0.98)
_MOST_NORM: Final = 1.0
_WHOLE: Final = 5
"""The last 1 / _WHOLE of the steps trains with values rounded to 8 bits."""
_WHOLE_RATE: Final = 0.2
"""Learning rate of these steps, relative to the peak of the others."""
_SCALED_BY: Final = 8192
"""Number of samples that determine the scale of hidden values."""


@dataclass(frozen=True)
class FitSettings:
    """Training options of a network.

    hidden:    widths of the two hidden layers; steps: optimiser steps; batch: samples in each; rate: peak learning rate
    keep:      share of the tiles of the first two layers that is kept, 1: all (tiles.py)
    precision: `float32`, or `mixed`: products in bfloat16 until the last steps; twice as fast if the processor has it

    The last fifth of the steps uses hidden values and a first layer rounded to 8 bits, at a fifth of the rate.
    """

    expects: bool
    hidden: tuple[int, ...] = HIDDEN["large"]
    keep: tuple[float, float] = (1.0, 1.0)
    steps: int = 8000
    batch: int = 8192
    rate: float = 3e-3
    seed: int = 1
    precision: str = "float32"

    def __post_init__(self) -> None:
        for name, (least, most) in {"steps": (1, 10**7), "batch": (1, 1 << 20), "rate": (1e-6, 1.0)}.items():
            if not least <= getattr(self, name) <= most:
                raise SettingsError(f"{name} must be {least} to {most}, not {getattr(self, name)}", name)
        if not all(0 < keep <= 1 for keep in self.keep):
            raise SettingsError(f"keep must be more than 0 and at most 1, not {self.keep}", "keep")
        if min(self.keep) < 1 and any(width % SUMS for width in self.hidden):
            raise SettingsError(
                f"layers of {self.hidden} hidden values cannot be divided into tiles: use multiples of {SUMS}", "hidden"
            )
        if self.precision not in ("float32", "mixed"):
            raise SettingsError(f"precision must be float32 or mixed, not {self.precision}", "precision")

    @property
    def dims(self) -> tuple[int, ...]:
        """Inputs, hidden layers, outputs."""
        return (row_bytes(self.expects) - LABELS, *self.hidden, 32)

    @property
    def float_steps(self) -> int:
        """Number of steps without rounding."""
        return self.steps - -(-self.steps // _WHOLE)

    def rate_at(self, step: int) -> float:
        """Learning rate of a step."""
        whole = step - self.float_steps
        if whole < 0:
            return runs.rate_at(step, self.float_steps, peak=self.rate)
        return runs.rate_at(whole, self.steps - self.float_steps, peak=_WHOLE_RATE * self.rate)

    def stored(self) -> dict[str, runs.Value]:
        """The options as stored in a checkpoint."""
        return {name: list(value) if isinstance(value, tuple) else value for name, value in asdict(self).items()}


@dataclass(frozen=True)
class Measured:
    """Progress of a network: steps done, bits a return on the last batches, and on held-out drives."""

    step: int
    trained_bits: float
    held_bits: float
    seconds: float


Watch = Callable[[Measured], None]


def fit(
    settings: FitSettings,
    samples: Sequence[Rows],
    held: list[Rows],
    checkpoint: Path,
    *,
    device: torch.device,
    watch: Watch,
    every: int = 500,
    stop_at: int | None = None,
    begin: Net | None = None,
) -> tuple[RiddleNet, runs.Checkpoint]:
    """Train a network, from its checkpoint if there is one. stop_at: stop at this step, like an interruption

    samples, held: rows of bytes, mapped from files or in memory; every: steps between two measurements
    begin: a network with the same layers for the initial weights
    Raises SettingsError or SourceError for a checkpoint of another run, or if it cannot be read or written.
    """
    runs.seed_torch(settings.seed)
    net = RiddleNet(settings.expects, settings.dims, begin).to(device)
    optimiser = _optimiser(net, settings)
    state = runs.load_checkpoint(checkpoint, device)
    if state is None:
        state = runs.Checkpoint(0, settings.stored(), net.state_dict(), optimiser.state_dict())
    state.require(settings.stored())
    net.load_state_dict(state.model)
    optimiser.load_state_dict(state.optimiser)
    net.whole = state.step > settings.float_steps
    tiles = Tiles(net, settings.keep, settings.float_steps)
    draw, loss = _Draw(samples, settings.batch), RiddleLoss(device)
    began, before, costs = time.monotonic(), state.seconds, []
    for step in range(state.step, settings.steps if stop_at is None else min(stop_at, settings.steps)):
        if step == settings.float_steps:
            some = torch.from_numpy(_Draw(samples, _SCALED_BY)(runs.step_rng(settings.seed, step, 1))).to(device)
            net.make_whole(values_of(some))
            optimiser = _optimiser(net, settings)
        tiles.before_step(step, optimiser)
        runs.set_rate(optimiser, settings.rate_at(step))
        rows = torch.from_numpy(draw(runs.step_rng(settings.seed, step))).to(device)
        mixed = settings.precision == "mixed" and not net.whole
        with torch.autocast(device.type, dtype=torch.bfloat16, enabled=mixed):
            odds = net(values_of(rows, torch.bfloat16 if mixed else torch.float32))
        cost = loss(odds.float(), rows).mean()
        optimiser.zero_grad()
        cost.backward()
        torch.nn.utils.clip_grad_norm_(net.parameters(), _MOST_NORM)
        optimiser.step()
        tiles.after_step()
        costs.append(float(cost.detach()) / math.log(2))
        if (step + 1) % every == 0 or step + 1 == settings.steps:
            seconds = before + time.monotonic() - began
            measured = Measured(step + 1, float(np.mean(costs)), mean_bits(net, held), seconds)
            costs = []
            log = [*state.log, asdict(measured)]
            state = runs.Checkpoint(step + 1, settings.stored(), net.state_dict(), optimiser.state_dict(), seconds, log)
            runs.save_checkpoint(checkpoint, state)
            watch(measured)
    return net, state


def _optimiser(net: RiddleNet, settings: FitSettings) -> torch.optim.AdamW:
    return torch.optim.AdamW(net.parameters(), lr=settings.rate, betas=_BETAS, weight_decay=0.0)


class _Draw:
    """Draws batches from several files; all rows are equally likely."""

    def __init__(self, samples: Sequence[Rows], batch: int) -> None:
        self._samples, self._batch = samples, batch
        self._ends = np.cumsum([len(rows) for rows in samples])

    def __call__(self, rng: np.random.Generator) -> Rows:
        """(batch, row) int8; rows of the same file are adjacent."""
        chosen = np.sort(rng.integers(0, self._ends[-1], self._batch))
        bounds = [0, *np.searchsorted(chosen, self._ends)]
        parts = [
            rows[chosen[first:last] - (end - len(rows))]
            for rows, end, first, last in zip(self._samples, self._ends, bounds, bounds[1:], strict=False)
            if last > first
        ]
        return np.concatenate(parts)

"""Training of one network on samples: seeded, with checkpoints, resumed to the weights of a run without a break."""

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
"""One in so many steps, the last ones, is taken with what has to fit 8 bits in them."""
_WHOLE_RATE: Final = 0.2
"""Of the peak of the others."""
_SCALED_BY: Final = 8192
"""Samples that hidden values are scaled by."""


@dataclass(frozen=True)
class FitSettings:
    """What a network is trained with.

    hidden:    widths of the two hidden layers; steps: of the optimiser; batch: samples in each; rate: its peak
    keep:      share of the tiles of the first two layers that is left in the end, 1: all (tiles.py)
    precision: `float32`, or `mixed`: products in bfloat16 until the last steps, twice as fast where processors have it

    The last fifth of the steps goes on with hidden values and the first layer in 8 bits, at a fifth of the rate.
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
                raise SettingsError(f"{name} = {getattr(self, name)}: {least} to {most} are possible", name)
        if not all(0 < keep <= 1 for keep in self.keep):
            raise SettingsError(f"keep = {self.keep}: shares of tiles above 0, 1 at most, are possible", "keep")
        if min(self.keep) < 1 and any(width % SUMS for width in self.hidden):
            raise SettingsError(
                f"layers of {self.hidden} hidden values have no whole tiles: take multiples of {SUMS}", "hidden"
            )
        if self.precision not in ("float32", "mixed"):
            raise SettingsError(f"precision = {self.precision}: float32 or mixed are possible", "precision")

    @property
    def dims(self) -> tuple[int, ...]:
        """Inputs, hidden layers, outputs."""
        return (row_bytes(self.expects) - LABELS, *self.hidden, 32)

    @property
    def float_steps(self) -> int:
        """Steps before anything is rounded."""
        return self.steps - -(-self.steps // _WHOLE)

    def rate_at(self, step: int) -> float:
        """Learning rate of a step."""
        whole = step - self.float_steps
        if whole < 0:
            return runs.rate_at(step, self.float_steps, peak=self.rate)
        return runs.rate_at(whole, self.steps - self.float_steps, peak=_WHOLE_RATE * self.rate)

    def stored(self) -> dict[str, runs.Value]:
        """As a checkpoint keeps them."""
        return {name: list(value) if isinstance(value, tuple) else value for name, value in asdict(self).items()}


@dataclass(frozen=True)
class Measured:
    """How a network stands: steps done, bits a return on the last batches, and on drives held out."""

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
    """Trains a network, from its checkpoint if there is one; `stop_at` ends earlier, as an interruption would.

    samples, held: rows of bytes, mapped from files or in memory; every: steps from one measurement to the next
    begin: a network of the same layers, whose weights are the first ones
    Raises SettingsError or SourceError for a checkpoint of another run, or one that cannot be read or written.
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
    """Batches of samples from several files, all rows equally likely."""

    def __init__(self, samples: Sequence[Rows], batch: int) -> None:
        self._samples, self._batch = samples, batch
        self._ends = np.cumsum([len(rows) for rows in samples])

    def __call__(self, rng: np.random.Generator) -> Rows:
        """(batch, row) int8; rows of a file stand together."""
        chosen = np.sort(rng.integers(0, self._ends[-1], self._batch))
        bounds = [0, *np.searchsorted(chosen, self._ends)]
        parts = [
            rows[chosen[first:last] - (end - len(rows))]
            for rows, end, first, last in zip(self._samples, self._ends, bounds, bounds[1:], strict=False)
            if last > first
        ]
        return np.concatenate(parts)

"""Steps of training with a checkpoint, for networks whose loss of a step depends on its number only."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, Protocol

import numpy as np
import torch
from torch import Tensor, nn

from lidarcodec.errors import SourceError
from lidarcodec.training.runs import Checkpoint, load_checkpoint, rate_at, save_checkpoint, set_rate

SAVE_SECONDS: Final = 60.0
WARM_UP: Final = 50


class Run(Protocol):
    """steps: of the whole training; rate: the peak"""

    @property
    def steps(self) -> int: ...

    @property
    def rate(self) -> float: ...


def train(
    net: nn.Module, loss_of: Callable[[int], Tensor], out: Path, run: Run, settings: dict[str, Any],
    device: torch.device, tick: Callable[[int, float], None], seconds: float | None, *,
    begin: Path | None = None, longest_gradient: float | None = None,
) -> None:  # fmt: skip
    """Train a network that is on the device, and leave it ready for use.

    loss_of: loss of a step;  out: file of the checkpoint, of which an existing one is continued
    settings: what a continued run must have in common;  tick(step, loss): called after each step
    seconds: stop with a checkpoint after this time;  begin: checkpoint whose weights a new run starts from
    Raises SettingsError for a checkpoint of other settings, SourceError.
    """
    optimiser = torch.optim.AdamW(net.parameters(), run.rate, weight_decay=1e-3)
    state = load_checkpoint(out, device)
    if state is None:
        state = Checkpoint(0, settings, {}, {})
        if begin is not None:
            net.load_state_dict(_begun(begin, device).model)
    state.require(settings)
    if state.step:
        net.load_state_dict(state.model)
        optimiser.load_state_dict(state.optimiser)
    began = saved = time.monotonic()
    before, losses = state.seconds, list[float]()
    net.train()
    for step in range(state.step, run.steps):
        set_rate(optimiser, rate_at(step, run.steps, peak=run.rate, warm_up=WARM_UP))
        loss = loss_of(step)
        optimiser.zero_grad()
        loss.backward()
        if longest_gradient is not None:
            nn.utils.clip_grad_norm_(net.parameters(), longest_gradient)
        optimiser.step()
        losses.append(float(loss.detach()))
        tick(step, losses[-1])
        state.step, now = step + 1, time.monotonic()
        state.seconds = before + now - began
        late = seconds is not None and now - began > seconds
        if now - saved > SAVE_SECONDS or state.step == run.steps or late:
            state.model, state.optimiser = net.state_dict(), optimiser.state_dict()
            state.log.append({"step": state.step, "loss": round(float(np.mean(losses)), 5)})
            save_checkpoint(out, state)
            saved, losses = now, []
            if late:
                break
    net.eval()


def _begun(path: Path, device: torch.device) -> Checkpoint:
    state = load_checkpoint(path, device)
    if state is None or not state.step:
        raise SourceError(f"there is no checkpoint {path} to begin with")
    return state

"""Training of the detector on labelled drives: blobs at the middles of objects by focal loss, and their boxes.

The views of a step depend on its number (`runs.step_rng`), so a resumed run equals an uninterrupted one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from lidarcodec.errors import SettingsError, SourceError
from lidarcodec.evaluation.detection.detector.network import KINDS
from lidarcodec.training.detector_batches import Batch, Examples
from lidarcodec.training.detector_data import Example
from lidarcodec.training.identity import digest_of
from lidarcodec.training.nets.detector_net import DetectorNet
from lidarcodec.training.runs import choose_device, seed_torch, step_rng
from lidarcodec.training.steps import train

BOX_WEIGHT: Final = 1.0
LONGEST_GRADIENT: Final = 10.0


@dataclass(frozen=True)
class DetectorRun:
    """Training options. batch: views in a step;  rate: peak"""

    seed: int = 1
    steps: int = 2000
    batch: int = 4
    rate: float = 3e-3

    def __post_init__(self) -> None:
        if self.steps < 1 or self.batch < 1:
            raise SettingsError("steps and batch are at least 1")


def train_detector(
    examples: Sequence[Example], out: Path, run: DetectorRun, device: str = "auto",
    tick: Callable[[int, float], None] = lambda step, loss: None, seconds: float | None = None,
    begin: Path | None = None,
) -> DetectorNet:  # fmt: skip
    """Train the network. out: file of the checkpoint; an existing one is continued. tick(step, loss): called after
    each step

    seconds: stop with a checkpoint after this time; begin: checkpoint whose weights a new run starts from
    Raises SettingsError, SourceError.
    """
    if not any(np.any(one.kind >= 0) for one in examples):
        raise SourceError("no object to train on: the drives have no labelled vehicle, cyclist or pedestrian")
    target = choose_device(device)
    seed_torch(run.seed)
    net: DetectorNet = DetectorNet().to(target)
    settings = asdict(run) | {"examples": digest_of(part for one in examples for part in one[:4])}
    given = Examples(examples, target)

    def loss_of(step: int) -> Tensor:
        rng = step_rng(run.seed, step)
        return _loss(net, given.batch(rng.integers(len(given), size=run.batch), rng))

    train(
        net, loss_of, out, run, settings, target, tick, seconds, begin=begin, longest_gradient=LONGEST_GRADIENT
    )  # fmt: skip
    return net


def _loss(net: DetectorNet, batch: Batch) -> Tensor:
    view, heat, weight, box, near = batch
    values = net(view)
    logits, boxes = values[:, : len(KINDS)], values[:, len(KINDS) :]
    chance = torch.sigmoid(logits)
    middle = (heat == 1).float()
    missed = -functional.logsigmoid(logits) * (1 - chance) ** 2 * middle
    false = -functional.logsigmoid(-logits) * chance**2 * (1 - heat) ** 4 * (1 - middle)
    objects = middle.sum().clamp(min=1)
    off = functional.smooth_l1_loss(boxes, box, reduction="none", beta=0.1).sum(dim=1) * near
    found: Tensor = ((missed + false) * weight).sum() / objects + BOX_WEIGHT * off.sum() / near.sum().clamp(min=1)
    return found

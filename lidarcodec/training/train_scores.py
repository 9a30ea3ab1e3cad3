"""Training of ScoreNet on annotated drives: classes high, low and ground, rank of the counts, rarely seen returns.

A step takes crops of two layouts of sensors, and each goes through the network alone. The last steps normalise by the
running means of all layouts, as the exported network does, so the network does not rely on the means of one.

The random crops of a step depend on its number (`runs.step_rng`), so a resumed run equals an uninterrupted one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from lidarcodec.errors import SettingsError, SourceError
from lidarcodec.reduction.score_image import score_image
from lidarcodec.training.identity import digest_of
from lidarcodec.training.nets.score_net import GROUND, HIGH, LOW, RANK, SELDOM, ScoreNet, in_place
from lidarcodec.training.runs import choose_device, seed_torch, step_rng
from lidarcodec.training.score_data import Example, crop, example_of, labelled, seldom_of
from lidarcodec.training.score_metrics import Agreement
from lidarcodec.training.steps import train

CLASS_WEIGHTS: Final = (1.0, 2.0, 0.7)
LAYOUTS: Final = 2
FEWEST_UNSETTLED: Final = 100
"""Steps that the means of batch normalisation need before they are right."""


@dataclass(frozen=True)
class ScoreRun:
    """Training options of ScoreNet.

    batch: crops of each layout in a step;  width: columns of a crop, a multiple of 16;  rate: peak
    settled: share of the steps after which the means of batch normalisation stay as they are
    """

    seed: int = 1
    steps: int = 3000
    batch: int = 2
    width: int = 512
    rate: float = 2e-3
    rank_weight: float = 2.0
    seldom_weight: float = 0.5
    settled: float = 0.6

    def __post_init__(self) -> None:
        if self.steps < 1 or self.batch < 1 or self.width < 16 or self.width % 16:
            raise SettingsError("steps and batch must be at least 1, and the width a multiple of 16")


def examples_of(drives: Sequence[Path], seed: int, every: int = 1) -> list[Example]:
    """All labelled frames of these drives, 3 MB each. Raises SourceError if there are none."""
    found = [example_of(frame, labels, np.random.default_rng([seed, k]))
             for k, (frame, labels) in enumerate(labelled(drives, every))]  # fmt: skip
    if not found:
        raise SourceError("there is no drive to train on: give at least one annotated drive")
    return found


def train_scores(
    examples: Sequence[Example], out: Path, run: ScoreRun, device: str = "auto",
    tick: Callable[[int, float], None] = lambda step, loss: None, seconds: float | None = None,
) -> ScoreNet:  # fmt: skip
    """Train the network. out: file of the checkpoint; an existing one is continued. tick(step, loss): called after
    each step

    seconds: stop with a checkpoint after this time;  Raises SettingsError, SourceError.
    """
    target = choose_device(device)
    seed_torch(run.seed)
    net: ScoreNet = ScoreNet().to(target)
    settings = asdict(run) | {"examples": digest_of(part for example in examples for part in example)}

    by_rows = _by_rows(examples)

    def loss_of(step: int) -> Tensor:
        if step >= max(run.settled * run.steps, FEWEST_UNSETTLED):
            _settle(net)
        rng = step_rng(run.seed, step)
        losses = [_loss(net, _batch(examples, by_rows, run, rng, target), run) for _ in range(LAYOUTS)]
        return torch.stack(losses).mean()

    train(net, loss_of, out, run, settings, target, tick, seconds)
    return net


def _by_rows(examples: Sequence[Example]) -> dict[int, list[int]]:
    """Number of rows -> which examples have them."""
    found: dict[int, list[int]] = {}
    for k, example in enumerate(examples):
        found.setdefault(example.label.shape[0], []).append(k)
    return found


def _settle(net: ScoreNet) -> None:
    for part in net.modules():
        if isinstance(part, torch.nn.BatchNorm2d):
            part.eval()


def _batch(
    examples: Sequence[Example], by_rows: Mapping[int, Sequence[int]], run: ScoreRun, rng: np.random.Generator,
    device: torch.device,
) -> list[Tensor]:  # fmt: skip
    """Crops of examples with as many rows as one that is drawn among all of them."""
    alike = by_rows[examples[int(rng.integers(len(examples)))].label.shape[0]]
    crops = [crop(examples[alike[int(rng.integers(len(alike)))]], run.width, rng) for _ in range(run.batch)]
    planes = [np.stack(plane) for plane in zip(*crops, strict=True)]
    dtypes = (torch.float32, torch.long, torch.float32, torch.float32)
    return [torch.from_numpy(np.ascontiguousarray(p)).to(device, d) for p, d in zip(planes, dtypes, strict=True)]


def _loss(net: ScoreNet, batch: Sequence[Tensor], run: ScoreRun) -> Tensor:
    features, label, rank, seldom = batch
    values = in_place(net(features))
    weights = torch.tensor(CLASS_WEIGHTS, device=values.device)
    total = functional.cross_entropy(values[:, : GROUND + 1], label, weight=weights, ignore_index=-1)
    asked = rank >= 0
    if bool(asked.any()):
        guessed = torch.sigmoid(values[:, RANK])[asked]
        total = total + run.rank_weight * functional.smooth_l1_loss(guessed, rank[asked], beta=0.2)
    asked = seldom >= 0
    if bool(asked.any()):
        lost = functional.binary_cross_entropy_with_logits(values[:, SELDOM][asked], seldom[asked])
        total = total + run.seldom_weight * lost
    found: Tensor = total
    return found


def measure_scores(net: ScoreNet, drives: Sequence[Path], every: int = 1) -> dict[str, Any]:
    """Results of `Agreement` for a network on annotated drives. Raises SourceError."""
    device = next(net.parameters()).device
    found = Agreement()
    for frame, truth in labelled(drives, every):
        image = score_image(frame)
        with torch.no_grad():
            values = in_place(net(torch.from_numpy(image.features)[None].to(device)))[0].cpu().numpy()
        at = values.reshape(len(values), -1)[:, image.pixel]
        places = np.flatnonzero(frame.valid)
        labels, counts = truth.labels.ravel()[places], truth.counts.ravel()[places]
        high = at[HIGH] - np.logaddexp(at[LOW], at[GROUND])
        found.add(high, at[: GROUND + 1].argmax(axis=0) + 1, labels, counts, at[RANK])
        seldom = seldom_of(counts, labels, frame.range.ravel()[places] * frame.sensor.range_step_m)
        found.add_seldom(at[SELDOM][seldom >= 0], seldom[seldom >= 0] > 0)
    return found.result()

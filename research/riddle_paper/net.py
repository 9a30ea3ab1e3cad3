"""RIDDLE's predictor: a PointNet over the neighbours of a return, and a decoder that picks an anchor and a residual.

Each neighbour goes through the same small network; the largest value of each of its outputs over all neighbours is the
embedding of the context. From that the attribute decoder says for each neighbour how likely it is the anchor, that is
the one whose range is nearest, and how far from it the range lies. The prediction is the likeliest anchor plus its
residual. What is learned: which neighbour is nearest (cross entropy), and the residual of that one (Huber).

>>> net = RiddlePaper(NetShape(temporal=0))
>>> sum(weights.numel() for weights in net.parameters())
102406
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import torch
from torch import nn
from torch.nn.functional import cross_entropy, huber_loss

RESIDUAL_UNIT_M: Final = 0.01
"""A residual of 1."""


@dataclass(frozen=True)
class NetShape:
    """Sizes of a predictor.

    spatial, temporal: neighbours in the frame and in the one before; features: numbers of a neighbour
    encoder: widths of the network of a neighbour, the last one of the embedding; decoder: widths after it
    """

    spatial: int = 99
    temporal: int = 0
    features: int = 7
    encoder: tuple[int, ...] = (32, 64, 128)
    decoder: tuple[int, ...] = (256, 128)

    @property
    def neighbours(self) -> int:
        """Anchors to choose from."""
        return self.spatial + self.temporal


class RiddlePaper(nn.Module):
    """The predictor."""

    def __init__(self, shape: NetShape) -> None:
        super().__init__()
        self.shape = shape
        self.encoder = _layers(shape.features, *shape.encoder)
        self.decoder = _layers(shape.encoder[-1] + 1, *shape.decoder)
        self.anchor = nn.Linear(shape.decoder[-1], shape.neighbours)
        self.residual = nn.Linear(shape.decoder[-1], shape.neighbours)
        with torch.no_grad():  # before anything is learned a residual is small: the anchor's range itself
            self.residual.weight *= 0.1
            self.residual.bias *= 0

    def forward(
        self, features: torch.Tensor, valid: torch.Tensor, step: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """(N, K) logits of each neighbour being the anchor, and (N, K) residual from each, in units of 1 cm.

        features: (N, K, features); valid: (N, K) bool, no anchor where not; step: (N,) how coarse the image is
        """
        context = self._embedding(features)
        decoded = self.decoder(torch.cat([context, step[:, None]], dim=1))
        logits = self.anchor(decoded).masked_fill(~valid, -1e9)
        return logits, self.residual(decoded)

    def _embedding(self, features: torch.Tensor) -> torch.Tensor:
        """(N, E) the largest value of each output of the encoder over the neighbours of a context.

        Only neighbours that have the largest value of some output, about a third, have a gradient. So all go through
        the encoder without one first, and those that matter a second time.
        """
        if not torch.is_grad_enabled():
            return self.encoder(features).amax(dim=1)
        with torch.no_grad():
            number = self.encoder[:-1](features).argmax(dim=1)  # (N, E); the last ReLU changes no order
        number += features.shape[1] * torch.arange(len(features), device=features.device)[:, None]
        matter = torch.zeros(features.shape[0] * features.shape[1], dtype=torch.bool, device=features.device)
        matter[number.flatten()] = True
        place = torch.cumsum(matter, 0) - 1
        found: torch.Tensor = self.encoder(features.flatten(0, 1)[matter]).gather(0, place[number])
        return found


def loss_of(
    logits: torch.Tensor, residuals: torch.Tensor, anchor: torch.Tensor, residual: torch.Tensor, weight: float = 0.5
) -> torch.Tensor:
    """(N,) cross entropy of the right anchor plus `weight` times the Huber loss of its residual.

    anchor: (N,) its number; residual: (N,) how far the range lies from it, in units of 1 cm
    """
    own = residuals.gather(1, anchor[:, None])[:, 0]
    return cross_entropy(logits, anchor, reduction="none") + weight * huber_loss(own, residual, reduction="none")


def predicted(logits: torch.Tensor, residuals: torch.Tensor, anchors_m: torch.Tensor) -> torch.Tensor:
    """(N,) range in metres: the likeliest anchor and its residual."""
    chosen = logits.argmax(dim=1, keepdim=True)
    return (anchors_m.gather(1, chosen) + RESIDUAL_UNIT_M * residuals.gather(1, chosen))[:, 0]


def _layers(*widths: int) -> nn.Sequential:
    layers: list[nn.Module] = []
    for before, after in pairwise(widths):
        layers += [nn.Linear(before, after), nn.ReLU(inplace=True)]
    return nn.Sequential(*layers)

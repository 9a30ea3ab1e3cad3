"""The torch form of lidarcodec/evaluation/detection/detector/network.py, with batch normalisation, for training."""

from __future__ import annotations

import math
from typing import Final

import torch
from torch import Tensor, nn
from torch.nn import functional

from lidarcodec.evaluation.detection.detector.network import BARE, KINDS, LAYERS, Layer

RARE: Final = 0.01
"""Probability of a middle before training."""


class DetectorNet(nn.Module):
    """(B, 3 + 8, 120, 120) logits and boxes of views (B, 15, 240, 240)."""

    def __init__(self) -> None:
        super().__init__()
        self.convolution = nn.ModuleDict(
            {
                name: nn.Conv2d(one.inputs, one.outputs, one.size, one.stride, one.size // 2, bias=name in BARE)
                for name, one in LAYERS.items()
            }
        )
        self.norm = nn.ModuleDict(
            {name: nn.BatchNorm2d(one.outputs) for name, one in LAYERS.items() if name not in BARE}
        )
        bias = self.convolution["out"].bias
        assert isinstance(bias, Tensor)
        with torch.no_grad():
            bias.zero_()
            bias[: len(KINDS)] = math.log(RARE / (1 - RARE))

    def forward(self, views: Tensor) -> Tensor:
        """Logits and boxes."""
        a = self._layer("a1", self._layer("a0", views))
        b = self._layer("b2", self._layer("b1", self._layer("b0", a)))
        c = self._layer("c2", self._layer("c1", self._layer("c0", b)))
        d = self._layer("d", torch.relu(_doubled(self._layer("up_c", c)) + b))
        e = self._layer("e", torch.relu(_doubled(self._layer("up_d", d)) + a))
        return self._layer("out", e)

    def _layer(self, name: str, values: Tensor) -> Tensor:
        found: Tensor = self.convolution[name](values)
        return found if name in BARE else torch.relu(self.norm[name](found))

    def folded(self) -> dict[str, Layer]:
        """The layers, with the normalisation in weights and biases."""
        layers: dict[str, Layer] = {}
        for name in LAYERS:
            part = self.convolution[name]
            assert isinstance(part, nn.Conv2d)
            weights, bias = part.weight.detach(), part.bias
            if bias is None:
                norm = self.norm[name]
                assert isinstance(norm, nn.BatchNorm2d)
                assert norm.running_var is not None
                assert norm.running_mean is not None
                factor = norm.weight.detach() / torch.sqrt(norm.running_var + norm.eps)
                weights = weights * factor[:, None, None, None]
                bias = norm.bias.detach() - norm.running_mean * factor
            layers[name] = Layer(weights.cpu().numpy(), bias.detach().cpu().numpy())
        return layers


def _doubled(values: Tensor) -> Tensor:
    return functional.interpolate(values, scale_factor=2.0, mode="nearest")

"""The network of codec `riddle` in torch, what it should say, and the same in whole numbers."""

from __future__ import annotations

import math
from collections.abc import Iterable
from itertools import pairwise
from typing import Final

import numpy as np
import numpy.typing as npt
import torch

from lidarcodec.codecs.riddle_weights import INPUT_UNIT, MIDDLE_TOP, OUTPUT_UNIT, Net, check_dims, run
from lidarcodec.codecs.riddle_weights import quantised as quantised_net
from lidarcodec.errors import SettingsError
from lidarcodec.training.riddle.samples import LABELS, Rows

HIDDEN: Final = {"small": (32, 32), "large": (96, 32), "largest": (192, 48)}
"""Hidden layers of each size."""
WORST: Final = 0.003
"""Bits a return that whole numbers may cost."""
_TOP: Final = MIDDLE_TOP / 128
_LIMIT: Final = 6.0
_CHUNK: Final = 16384
_DEPTH: Final = 4
_SHARES: Final = (1.0, 0.5, 0.25)
"""What the log odds of the first offset bit say of it and of the next two."""


def _paths() -> tuple[npt.NDArray[np.int64], npt.NDArray[np.float32]]:
    """Of each leaf, (16, 7): the outputs that speak of it, and the sign with which each stands in the loss."""
    decisions = _DEPTH + len(_SHARES)
    outputs, signs = np.zeros((16, decisions), np.int64), np.zeros((16, decisions), np.float32)
    for leaf in range(16):
        node = 1
        for level in range(_DEPTH):
            bit = leaf >> (_DEPTH - 1 - level) & 1
            outputs[leaf, level], signs[leaf, level] = node, 1 - 2 * bit
            node = 2 * node + bit
        outputs[leaf, _DEPTH:] = 16 + leaf
    return outputs, signs


_OUTPUTS, _SIGNS = _paths()


class RiddleNet(torch.nn.Module):
    """Inputs (n, 72 or 112) in units to log odds (n, 32) in natural units. Raises SectionError for other sizes."""

    def __init__(self, expects: bool, dims: tuple[int, ...]) -> None:
        check_dims(expects, dims)
        super().__init__()
        self.expects, self.dims = expects, dims
        self.layers = torch.nn.ModuleList(torch.nn.Linear(into, out) for into, out in pairwise(dims))
        with torch.no_grad():
            self.layers[-1].weight *= 0.3

    def forward(self, values: torch.Tensor) -> torch.Tensor:
        for layer in self.layers[:-1]:
            values = torch.nn.functional.hardtanh(layer(values), 0.0, _TOP)
        odds: torch.Tensor = self.layers[-1](values)
        return odds

    def quantised(self, size: int) -> Net:
        """This network in whole numbers. Raises SettingsError if its weights are too large for them."""
        made = [
            (layer.weight.detach().cpu().double().numpy(), layer.bias.detach().cpu().double().numpy())
            for layer in self.layers
        ]
        return quantised_net(self.expects, size, made)


def values_of(rows: torch.Tensor, dtype: torch.dtype = torch.float32) -> torch.Tensor:
    """Inputs of samples, (n, inputs), in units."""
    return rows[:, :-LABELS].to(dtype) * (1 / INPUT_UNIT)


class RiddleLoss:
    """Natural units that samples cost under log odds: of the leaf's four bits, and of the first three offset bits."""

    def __init__(self, device: torch.device) -> None:
        self._outputs = torch.from_numpy(_OUTPUTS).to(device)
        self._signs = torch.from_numpy(_SIGNS).to(device)
        self._shares = torch.tensor(_SHARES, device=device)

    def __call__(self, odds: torch.Tensor, rows: torch.Tensor) -> torch.Tensor:
        """(n,) cost of each. odds: (n, 32) float32; rows: (n, inputs + 4) int8."""
        leaf, bits = rows[:, -LABELS].long(), rows[:, 1 - LABELS :]
        costs = torch.nn.functional.softplus(odds.gather(1, self._outputs[leaf]) * self._with_bits(leaf, bits))
        return costs[:, :_DEPTH].sum(1) + (costs[:, _DEPTH:] * (bits >= 0)).sum(1)

    def _with_bits(self, leaf: torch.Tensor, bits: torch.Tensor) -> torch.Tensor:
        signs = self._signs[leaf]
        signs[:, _DEPTH:] = (1.0 - 2.0 * (bits == 1)) * self._shares
        return signs


def mean_bits(net: RiddleNet, parts: Iterable[Rows]) -> float:
    """Bits a return that samples cost under the network, its outputs limited as they are in whole numbers."""
    device = next(net.parameters()).device
    loss, cost, count = RiddleLoss(device), 0.0, 0
    with torch.no_grad():
        for part in parts:
            for first in range(0, len(part), _CHUNK):
                rows = torch.from_numpy(np.array(part[first : first + _CHUNK])).to(device)
                cost += float(loss(net(values_of(rows)).clamp(-_LIMIT, _LIMIT), rows).sum())
                count += len(rows)
    return cost / max(count, 1) / math.log(2)


def mean_bits_whole(net: Net, parts: Iterable[Rows]) -> float:
    """The same of a network in whole numbers, by the reference."""
    cost, count = 0.0, 0
    for part in parts:
        for first in range(0, len(part), _CHUNK):
            rows = np.array(part[first : first + _CHUNK])
            odds = run(net, rows[:, :-LABELS]) / OUTPUT_UNIT
            leaf, bits = rows[:, -LABELS].astype(np.intp), rows[:, 1 - LABELS :]
            signs = _SIGNS[leaf]
            signs[:, _DEPTH:] = (1 - 2 * (bits == 1)) * np.array(_SHARES)
            costs = np.logaddexp(0, np.take_along_axis(odds, _OUTPUTS[leaf], axis=1) * signs)
            cost += float(costs[:, :_DEPTH].sum() + (costs[:, _DEPTH:] * (bits >= 0)).sum())
            count += len(rows)
    return cost / max(count, 1) / math.log(2)


def exported(net: RiddleNet, size: int, parts: list[Rows]) -> tuple[Net, float]:
    """The network in whole numbers, and what it costs on samples, bits a return.

    Raises SettingsError if that is more than 0.003 bits away from what the network in floats costs.
    """
    whole = net.quantised(size)
    exact, found = mean_bits(net, parts), mean_bits_whole(whole, parts)
    if not abs(found - exact) <= WORST:
        raise SettingsError(f"in whole numbers a network takes {found:.4f} bits a return, in floats {exact:.4f}")
    return whole, found

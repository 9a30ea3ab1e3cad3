"""The network of codec `riddle` in torch, its loss, and its conversion to integers."""

from __future__ import annotations

import math
from collections.abc import Iterable
from itertools import pairwise
from typing import Final

import numpy as np
import numpy.typing as npt
import torch

from lidarcodec.errors import SettingsError
from lidarcodec.network.networks import (
    CASE_BITS,
    CASES,
    INPUT_UNIT,
    INPUTS_ALONE,
    MIDDLE_BITS,
    MIDDLE_TOP,
    OUTPUT_UNIT,
    Net,
    cases_in_floats,
    cases_of,
    check_dims,
    in_floats,
    run,
)
from lidarcodec.network.networks import quantised as quantised_net
from lidarcodec.training.riddle.extraction import LABELS, SAID, Rows

HIDDEN: Final = {"small": (32, 32), "large": (96, 32), "largest": (192, 48)}
"""Hidden layers of each size."""
KEEP: Final = {
    "small": ((1.0, 1.0), (1.0, 1.0)),
    "large": ((0.6, 0.6), (0.55, 0.6)),
    "largest": ((0.45, 0.4), (0.3, 0.33)),
}
"""Share of the tiles of the first two layers that is kept, for each size, alone and expecting (tiles.py)."""
WORST: Final = 0.003
"""Largest loss by the conversion to integers, in bits a return."""
_TOP: Final = MIDDLE_TOP / (1 << MIDDLE_BITS)
_LIMIT: Final = 6.0
_LEAST_LEFT: Final = 0.085
"""The coder's smallest probability."""
_SMOOTH: Final = 0.1
"""Share of the loss without the coder's limit of probabilities, so that there is always a gradient."""
_BYTE_SHIFT: Final = 6
_MOST_WEIGHT: Final = 127 / 2**_BYTE_SHIFT
"""Largest weight of the first layer, in 8 bits. With 8 bits the second layer would cost too many bits a return."""
_MOST_CASE: Final = 127 / 2**CASE_BITS
"""Largest bias of a case, in 8 bits."""
_MOST_SECOND: Final = 7.5
"""Largest weight of the second layer, with 12 fractional bits."""
_MOST_SCALED: Final = 16.0
_OFTEN_REACHED: Final = 0.875
"""After scaling, one hidden value in two thousand may exceed this share of the largest possible value."""
_CHUNK: Final = 16384
_DEPTH: Final = 4
_BESIDE: Final = 0.9
"""Weight of the context predictions."""
_SHARES: Final = (1.0, 0.5, 0.25)
"""Factors from the log odds of the first offset bit to those of it and the next two."""


def _paths() -> tuple[npt.NDArray[np.int64], npt.NDArray[np.float32]]:
    """For each leaf, (16, 7): the outputs on its path, and their signs in the loss."""
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
    """Inputs (n, 72 or 112) in units to log odds (n, 32) in natural units. Raises SectionError for other sizes.

    The first layer has separate biases for each row and each scale; they start at 0.

    whole: whether hidden values and the first layer's weights are rounded to 8 bits, as in the converted network.
    Gradients pass the rounding unchanged (straight-through estimator, Bengio 2013, arXiv:1308.3432).
    """

    def __init__(self, expects: bool, dims: tuple[int, ...], begin: Net | None = None) -> None:
        check_dims(expects, dims)
        super().__init__()
        self.expects, self.dims, self.whole = expects, dims, False
        self.layers = torch.nn.ModuleList(torch.nn.Linear(into, out) for into, out in pairwise(dims))
        with torch.no_grad():
            self.layers[-1].weight *= 0.3
            for layer, (weight, bias) in zip(self.layers, [] if begin is None else in_floats(begin), strict=False):
                layer.weight.copy_(torch.from_numpy(weight))
                layer.bias.copy_(torch.from_numpy(bias))
            self.cases = torch.nn.Parameter(torch.zeros(CASES, dims[1]))
            if begin is not None and (known := cases_in_floats(begin)) is not None:
                self.cases.copy_(torch.from_numpy(known))

    def forward(self, values: torch.Tensor) -> torch.Tensor:
        first, second, last = self.layers
        of_cases = self._of_cases(values)
        for layer in (first, second):
            weight = _in_bytes(layer.weight) if self.whole and layer is first else layer.weight
            values = torch.nn.functional.linear(values, weight, layer.bias)
            if layer is first:
                values = values + of_cases
            values = torch.nn.functional.hardtanh(values, 0.0, _TOP)
            if self.whole:
                values = _rounded(values, MIDDLE_BITS)
        odds: torch.Tensor = last(values)
        return odds

    def _of_cases(self, values: torch.Tensor) -> torch.Tensor:
        """(n, hidden): biases of the first layer from the rows and scales of returns."""
        rows, scales = cases_of((values[:, :INPUTS_ALONE].float() * INPUT_UNIT).round().long())
        cases = _rounded(self.cases.clamp(-_MOST_CASE, _MOST_CASE), CASE_BITS) if self.whole else self.cases
        return torch.nn.functional.embedding(rows, cases) + torch.nn.functional.embedding(scales, cases)

    @torch.no_grad()
    def make_whole(self, values: torch.Tensor) -> None:
        """Round from here on. Each hidden value is scaled to use 8 bits, as far as 8 bits suffice for its weights.

        values: (n, inputs) example inputs, in units
        """
        first = self.layers[0]
        for layer, following in pairwise(self.layers):
            found = torch.nn.functional.linear(values, layer.weight, layer.bias)
            found = torch.relu(found + self._of_cases(values) if layer is first else found)
            scale = _OFTEN_REACHED * _TOP / torch.quantile(found, 0.9995, dim=0).clamp(min=0.1)
            most = _MOST_WEIGHT if layer is first else _MOST_SECOND
            scale = torch.minimum(scale, most / layer.weight.abs().amax(1).clamp(min=1e-6))
            scale = scale.clamp(max=_MOST_SCALED)
            if layer is first:
                scale = torch.minimum(scale, _MOST_CASE / self.cases.abs().amax(0).clamp(min=1e-6))
                self.cases *= scale
            layer.weight *= scale[:, None]
            layer.bias *= scale
            following.weight /= scale
            values = (found * scale).clamp(max=_TOP)
        self.whole = True

    def quantised(self, size: int) -> Net:
        """This network converted to integers. Raises SettingsError if its weights are too large."""
        made = []
        for layer in self.layers:
            weight = layer.weight.detach()
            if self.whole and layer is self.layers[0]:
                weight = _in_bytes(weight)
            made.append((weight.cpu().double().numpy(), layer.bias.detach().cpu().double().numpy()))
        return quantised_net(self.expects, size, made, self.cases.detach().cpu().double().numpy())


def _in_bytes(weight: torch.Tensor) -> torch.Tensor:
    return _rounded(weight.clamp(-_MOST_WEIGHT, _MOST_WEIGHT), _BYTE_SHIFT)


def _rounded(values: torch.Tensor, bits: int) -> torch.Tensor:
    return values + (torch.round(values * 2**bits) * 2**-bits - values).detach()


def values_of(rows: torch.Tensor, dtype: torch.dtype = torch.float32) -> torch.Tensor:
    """(n, inputs), the inputs of samples in units."""
    return rows[:, :-LABELS].to(dtype) * (1 / INPUT_UNIT)


class RiddleLoss:
    """Cost of samples in nats, from log odds and context predictions: the leaf's four bits and the first three offset
    bits.

    Probabilities are limited as in the coder. A small part (`smooth`) of the loss has no limit, so that there is
    always a gradient.
    """

    def __init__(self, device: torch.device, smooth: float = _SMOOTH) -> None:
        self._outputs = torch.from_numpy(_OUTPUTS).to(device)
        self._signs = torch.from_numpy(_SIGNS).to(device)
        self._shares = torch.tensor((1.0,) * _DEPTH + _SHARES, device=device)
        self._smooth = smooth

    def __call__(self, odds: torch.Tensor, rows: torch.Tensor) -> torch.Tensor:
        """(n,) cost of each sample. odds: (n, 32) float32; rows: (n, inputs + 18) int8"""
        leaf, bits = rows[:, -LABELS].long(), rows[:, 1 - LABELS : -2 * SAID]
        said = rows[:, -2 * SAID :].contiguous().view(torch.int16) * (_BESIDE / OUTPUT_UNIT)
        wrong = (odds.gather(1, self._outputs[leaf]) * self._shares + said) * self._with_bits(leaf, bits)
        rare = 0.5 * (1 - (wrong.abs() / _LIMIT).clamp(max=1)).clamp(min=_LEAST_LEFT) ** 3
        costs = torch.where(wrong > 0, -torch.log(rare), -torch.log1p(-rare))
        if self._smooth:
            costs = costs * (1 - self._smooth) + self._smooth * torch.nn.functional.softplus(wrong)
        return costs[:, :_DEPTH].sum(1) + (costs[:, _DEPTH:] * (bits >= 0)).sum(1)

    def _with_bits(self, leaf: torch.Tensor, bits: torch.Tensor) -> torch.Tensor:
        signs = self._signs[leaf]
        signs[:, _DEPTH:] = 1.0 - 2.0 * (bits == 1)
        return signs


def mean_bits(net: RiddleNet, parts: Iterable[Rows]) -> float:
    """Mean bits a return of samples, with the outputs limited as in the integer network."""
    device = next(net.parameters()).device
    loss, cost, count = RiddleLoss(device, smooth=0.0), 0.0, 0
    with torch.no_grad():
        for part in parts:
            for first in range(0, len(part), _CHUNK):
                rows = torch.from_numpy(np.array(part[first : first + _CHUNK])).to(device)
                cost += float(loss(net(values_of(rows)).clamp(-_LIMIT, _LIMIT), rows).sum())
                count += len(rows)
    return cost / max(count, 1) / math.log(2)


def mean_bits_whole(net: Net, parts: Iterable[Rows]) -> float:
    """The same for an integer network, by the reference implementation."""
    loss, cost, count = RiddleLoss(torch.device("cpu"), smooth=0.0), 0.0, 0
    for part in parts:
        for first in range(0, len(part), _CHUNK):
            rows = np.array(part[first : first + _CHUNK])
            odds = torch.from_numpy((run(net, rows[:, :-LABELS]) / OUTPUT_UNIT).astype(np.float32))
            cost += float(loss(odds, torch.from_numpy(rows)).sum())
            count += len(rows)
    return cost / max(count, 1) / math.log(2)


def exported(net: RiddleNet, size: int, parts: list[Rows]) -> tuple[Net, float]:
    """The network converted to integers, and its mean bits a return on samples.

    Raises SettingsError if that differs by more than 0.003 bits from the network in floats.
    """
    whole = net.quantised(size)
    exact, found = mean_bits(net, parts), mean_bits_whole(whole, parts)
    if not abs(found - exact) <= WORST:
        raise SettingsError(f"the integer network needs {found:.4f} bits a return, but the float network {exact:.4f}")
    return whole, found

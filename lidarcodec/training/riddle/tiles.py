"""Pruning of weights in tiles of sixteen hidden values and four inputs. The coder skips pruned tiles.

The saliency of a tile is the increase of the loss without it, by the second derivative (LeCun, Denker and Solla 1990,
"Optimal Brain Damage", eq. 5). The optimiser's mean of squared gradients is used as second derivative. The tiles with
the lowest saliency are pruned gradually (Zhu and Gupta 2017, arXiv:1710.01878, eq. 1). Before that, hidden values are
sorted so that those with the same inputs are in the same tiles.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt
import torch

from lidarcodec.network.networks import Net
from lidarcodec.network.tiles import INPUTS, SUMS, tiles_left
from lidarcodec.training.riddle.nets import RiddleNet

EVERY: Final = 50
"""Most steps between two prunings."""
_LOOKS: Final = 40
"""Number of prunings in a shorter run."""
_BEGIN, _END = 0.05, 0.55
_ORDERS: Final = 8
"""Number of random start orders in the search for the best order."""

Worth = npt.NDArray[np.float64]


def in_tiles(values: torch.Tensor) -> torch.Tensor:
    """Sums over the tiles of a layer: (out, in) to (out / 16, in / 4); the last tile is padded with 0."""
    filled = torch.nn.functional.pad(values, (0, 0, 0, -len(values) % SUMS))
    return filled.reshape(len(filled) // SUMS, SUMS, -1, INPUTS).sum((1, 3))


def share_left(net: Net) -> list[float]:
    """Share of tiles with weights, for the first two layers."""
    return [round(float(tiles_left(layer.weights).mean()), 3) for layer in net.layers[:2]]


class Tiles:
    """Prunes the tiles of the first two layers.

    keep: final share of tiles for both layers; steps: number of steps until this share
    The weights alone tell which tiles are pruned, so a resumed run continues like an uninterrupted one.
    """

    def __init__(self, net: RiddleNet, keep: tuple[float, float], steps: int) -> None:
        self._net, self._keep = net, keep
        self._every = max(1, min(EVERY, steps // _LOOKS))
        first, last = (round(share * steps / self._every) for share in (_BEGIN, _END))
        self._looks = range(max(first, 1), last + 1)
        self._left = self._with_weights()

    def _with_weights(self) -> list[torch.Tensor]:
        return [(in_tiles(layer.weight.detach().abs()) > 0).float() for layer in self._layers]

    @property
    def _layers(self) -> list[torch.nn.Linear]:
        return [layer for layer in self._net.layers[:2] if isinstance(layer, torch.nn.Linear)]

    def before_step(self, step: int, optimiser: torch.optim.Optimizer) -> None:
        """Prune tiles or sort hidden values, if due before this step."""
        look, between = divmod(step, self._every)
        if between or look not in self._looks or all(keep == 1 for keep in self._keep):
            return
        first = self._left[0]
        if look == self._looks[0] and int(first.sum()) > round(self._keep[0] * first.numel()):
            self._put_in_order(optimiser)
        way = (look - self._looks[0] + 1) / len(self._looks)
        for number, (layer, keep) in enumerate(zip(self._layers, self._keep, strict=True)):
            worth = in_tiles(layer.weight.detach() ** 2 * optimiser.state[layer.weight]["exp_avg_sq"])
            count = max(1, round((keep + (1 - keep) * (1 - way) ** 3) * worth.numel()))
            best = torch.zeros_like(worth).flatten()
            best[worth.flatten().argsort(descending=True, stable=True)[:count]] = 1
            self._left[number] *= best.reshape(worth.shape)
        self.after_step()

    def after_step(self) -> None:
        """Set pruned weights to 0 again, because the optimiser changes all weights."""
        with torch.no_grad():
            for layer, left in zip(self._layers, self._left, strict=True):
                if not left.all():
                    layer.weight *= left.repeat_interleave(SUMS, 0)[: len(layer.weight)].repeat_interleave(INPUTS, 1)

    def _put_in_order(self, optimiser: torch.optim.Optimizer) -> None:
        first, second = self._layers
        worth = first.weight.detach() ** 2 * optimiser.state[first.weight]["exp_avg_sq"]
        of_inputs = worth.reshape(len(worth), -1, INPUTS).sum(2).sqrt().cpu().double().numpy()
        order = torch.from_numpy(order_of(of_inputs, self._keep[0])).to(first.weight.device)
        with torch.no_grad():
            for values, along in ((first.weight, 0), (first.bias, 0), (second.weight, 1), (self._net.cases, 1)):
                state = optimiser.state[values]
                for part in (values, state["exp_avg"], state["exp_avg_sq"]):
                    part.copy_(part.index_select(along, order))
        self._left = self._with_weights()


def order_of(worth: Worth, keep: float) -> npt.NDArray[np.int64]:
    """An order of hidden values that maximises the saliency of the kept tiles. The search starts from random orders.

    worth: (hidden, inputs / 4), saliency of each four inputs for each hidden value
    keep:  share of kept tiles
    """
    rng, found = np.random.default_rng(1), [(_kept(worth, np.arange(len(worth)), keep)[0], np.arange(len(worth)))]
    for _ in range(_ORDERS):
        order, before = rng.permutation(len(worth)), 0.0
        kept, left = _kept(worth, order, keep)
        while kept > before:
            found.append((kept, order))
            before, order = kept, _with_room(worth @ left.T)
            kept, left = _kept(worth, order, keep)
    return max(found, key=lambda each: each[0])[1]


def _kept(worth: Worth, order: npt.NDArray[np.int64], keep: float) -> tuple[float, Worth]:
    """Total saliency of the best tiles of an order, and a mask of them, (blocks, inputs / 4) of 0 and 1."""
    tiles = worth[order].reshape(-1, SUMS, worth.shape[1]).sum(1)
    left = (tiles >= np.sort(tiles, axis=None)[-max(1, round(keep * tiles.size))]).astype(np.float64)
    return float((tiles * left).sum()), left


def _with_room(worth: Worth) -> npt.NDArray[np.int64]:
    """Assigns hidden values to blocks: each to the block with its highest saliency that has room, highest first.
    worth: (hidden, blocks)"""
    blocks = np.full(len(worth), -1)
    room = np.full(worth.shape[1], SUMS)
    for value, block in zip(*np.unravel_index(np.argsort(-worth, axis=None, kind="stable"), worth.shape), strict=True):
        if blocks[value] < 0 and room[block]:
            blocks[value] = block
            room[block] -= 1
    return np.argsort(blocks, kind="stable")

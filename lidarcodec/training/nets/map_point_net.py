"""The torch form of lidarcodec/maps/select/point_net.py, with batch normalisation, for training.

The layers are given, so that this module needs to know no map.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn

Folded = dict[str, tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]]
_BARE = ("t1_e", "t2_e", "whole", "out")
"""Layers without normalisation. `whole` is added to `own` before that is normalised."""


class MapPointNet(nn.Module):
    """(B, N) logits of being kept, from windows (B, N, 3) of points in a cube of side 1."""

    def __init__(self, layers: Mapping[str, tuple[int, int]]) -> None:
        super().__init__()
        self.linear = nn.ModuleDict(
            {name: nn.Linear(inputs, outputs, bias=name != "whole") for name, (inputs, outputs) in layers.items()}
        )
        self.norm = nn.ModuleDict(
            {name: nn.BatchNorm1d(outputs) for name, (_, outputs) in layers.items() if name not in _BARE}
        )
        for name in ("t1_e", "t2_e"):
            nn.init.zeros_(self.linear[name].weight)
            nn.init.zeros_(self.linear[name].bias)

    def begin_at(self, share: float) -> None:
        """Set the last bias so that all points are kept with this probability before training."""
        nn.init.constant_(self.linear["out"].bias, float(np.log(share / max(1 - share, 1e-6))))

    def forward(self, windows: Tensor) -> tuple[Tensor, Tensor]:
        """The logits, and how far T2 is from a rotation: the mean square of what is not the identity in T2 T2'."""
        batch, count, _ = windows.shape
        moved = torch.bmm(windows, self._transform("t1", windows, 3))
        a = self._layer("a", moved)
        b = self._layer("b", a)
        c = self._layer("c", b)
        turn = self._transform("t2", c, 128)
        turned = torch.bmm(c, turn)
        d = self._layer("d", turned)
        whole = self._most(d)
        own = self.linear["own"](torch.cat([a, b, c, turned, d], dim=2)) + self.linear["whole"](whole)[:, None]
        hidden = torch.relu(self.norm["own"](own.reshape(batch * count, -1))).reshape(batch, count, -1)
        values: Tensor = self.linear["out"](self._layer("g", self._layer("f", hidden)))[:, :, 0]
        off = torch.bmm(turn, turn.transpose(1, 2)) - torch.eye(turn.shape[1], device=turn.device)
        return values, off.square().sum(dim=(1, 2)).mean()

    def _layer(self, name: str, values: Tensor) -> Tensor:
        flat = self.norm[name](self.linear[name](values.reshape(-1, values.shape[-1])))
        return torch.relu(flat).reshape(*values.shape[:-1], -1)

    def _most(self, values: Tensor) -> Tensor:
        """(B, 2048) the largest value of layer `e` over the points.

        Only the points that have it pass on a gradient, so only these are computed with one: that saves two fifths of
        the time of a step. Means and deviations of the normalisation count as constants here.
        """
        linear, norm = self.linear["e"], self.norm["e"]
        with torch.no_grad():
            flat = linear(values.reshape(-1, values.shape[-1]))
            every = norm(flat).reshape(*values.shape[:2], -1)
            if not self.training:
                return torch.relu(every.amax(dim=1))
            at = every.argmax(dim=1)
            mean, deviation = flat.mean(dim=0), torch.sqrt(flat.var(dim=0, unbiased=False) + norm.eps)
        chosen = torch.gather(values, 1, at[:, :, None].expand(-1, -1, values.shape[-1]))
        largest = torch.einsum("bkc,kc->bk", chosen, linear.weight) + linear.bias
        return torch.relu((largest - mean) / deviation * norm.weight + norm.bias)

    def _transform(self, name: str, values: Tensor, size: int) -> Tensor:
        for part in "abc":
            values = self._layer(f"{name}_{part}", values)
        flat = self.linear[f"{name}_e"](self._layer(f"{name}_d", values.amax(dim=1)))
        return flat.reshape(-1, size, size) + torch.eye(size, device=flat.device)

    def folded(self) -> Folded:
        """Weights (outputs, inputs) and bias of each layer, with the normalisation in them."""
        found: Folded = {}
        for name, linear in self.linear.items():
            norm = self.norm["own" if name == "whole" else name] if name == "whole" or name in self.norm else None
            weights = linear.weight.detach().cpu().double()
            bias = torch.zeros(len(weights)).double() if linear.bias is None else linear.bias.detach().cpu().double()
            if norm is not None:
                scale = (norm.weight / torch.sqrt(norm.running_var + norm.eps)).detach().cpu().double()
                weights = weights * scale[:, None]
                if name != "whole":
                    bias = (bias - norm.running_mean.cpu().double()) * scale + norm.bias.detach().cpu().double()
            found[name] = weights.numpy().astype(np.float32), bias.numpy().astype(np.float32)
        return found

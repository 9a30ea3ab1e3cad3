"""PocoNet: classifies the points of a scan by RandLA-Net with global feature attention, trained as a siamese pair.

    fc 4 -> 8
    4 stages: local spatial encoding and attentive pooling, twice, with a shortcut; a random quarter of the points is
              kept, each with the largest features of its 12 neighbours     8 -> 32 -> 128 -> 256 -> 512
    global feature attention (equations 4 and 5): every point attends to every other; a codeword of 1024 for the scan
    the codeword joined to each point's 512 features; 4 stages of upsampling from the nearest point; head of 3

docs/reduction.md describes our choices for details that the paper does not give: the stages are those of RandLA-Net on
SemanticKITTI, and f and g of the attention are an eighth as wide as h. `poco_data.Levels` has neighbours and samples.
"""

from __future__ import annotations

from typing import Any, Final

import torch
from torch import Tensor, nn

NEIGHBOURS: Final = 12
STAGES: Final = (16, 64, 128, 256)
CODEWORD: Final = 1024
CLASSES: Final = 3
_SLOPE: Final = 0.2


def gathered(values: Tensor, places: Tensor) -> Tensor:
    """(B, D, K, N) of values (B, D, M) at places (B, K, N); (B, D, N) for places (B, N)."""
    batch, depth, _ = values.shape
    flat = places.reshape(batch, 1, -1).expand(-1, depth, -1)
    found: Tensor = torch.gather(values, 2, flat).reshape(batch, depth, *places.shape[1:])
    return found


def _shared(channels: int, out: int, *, flat: bool = False) -> nn.Sequential:
    """The same small network at every point: (B, channels, N) or, if not flat, (B, channels, K, N)."""
    kernel = nn.Conv1d(channels, out, 1, bias=False) if flat else nn.Conv2d(channels, out, 1, bias=False)
    norm = nn.BatchNorm1d(out) if flat else nn.BatchNorm2d(out)
    return nn.Sequential(kernel, norm, nn.LeakyReLU(_SLOPE))


class WeightedSum(torch.autograd.Function):
    """Sum of features (B, D, K, N) over K with the weights softmax(scores): (B, D, N).

    As one function, because its gradient is simple: with w the weights, s the sum and g the gradient of s, that of the
    features is w g, and that of the scores w g (feature - s). Training by steps of torch keeps and reads three times as
    much memory, which is what it waits for.
    """

    @staticmethod
    def forward(ctx: Any, features: Tensor, scores: Tensor) -> Tensor:
        weights = torch.softmax(scores, dim=2)
        pooled = (features * weights).sum(dim=2)
        ctx.save_for_backward(features, weights, pooled)
        return pooled

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, Tensor]:
        features, weights, pooled = ctx.saved_tensors
        of_features = weights * gradients[0].unsqueeze(2)
        return of_features, (features - pooled.unsqueeze(2)).mul_(of_features)


class AttentivePooling(nn.Module):
    """Weighted sum of the features of a point's neighbours with learned scores, then a shared network."""

    def __init__(self, channels: int, out: int) -> None:
        super().__init__()
        self.scores = nn.Conv2d(channels, channels, 1, bias=False)
        self.after = _shared(channels, out, flat=True)

    def forward(self, features: Tensor) -> Tensor:
        """(B, out, N) from (B, channels, K, N)."""
        pooled: Tensor = self.after(WeightedSum.apply(features, self.scores(features)))
        return pooled


class LocalAggregation(nn.Module):
    """Local spatial encoding and attentive pooling, twice, with a shortcut: (B, 2 out, N)."""

    def __init__(self, channels: int, out: int) -> None:
        super().__init__()
        half = out // 2
        self.before = _shared(channels, half, flat=True)
        self.place1, self.place2 = _shared(10, half), _shared(half, half)
        self.pool1, self.pool2 = AttentivePooling(out, half), AttentivePooling(out, out)
        self.after = nn.Sequential(nn.Conv1d(out, 2 * out, 1, bias=False), nn.BatchNorm1d(2 * out))
        self.short = nn.Sequential(nn.Conv1d(channels, 2 * out, 1, bias=False), nn.BatchNorm1d(2 * out))
        self.bend = nn.LeakyReLU(_SLOPE)

    def forward(self, features: Tensor, points: Tensor, near: Tensor) -> Tensor:
        """features: (B, channels, N), points: (B, 3, N), near: (B, K, N) indices of each point's neighbours."""
        there = gathered(points, near)
        here = points.unsqueeze(2).expand_as(there)
        apart = here - there
        far = apart.square().sum(dim=1, keepdim=True).sqrt_()
        encoded = self.place1(torch.cat([far, apart, here, there], 1))
        found = self.before(features)
        found = self.pool1(torch.cat([gathered(found, near), encoded], 1))
        encoded = self.place2(encoded)
        found = self.pool2(torch.cat([gathered(found, near), encoded], 1))
        whole: Tensor = self.bend(self.after(found) + self.short(features))
        return whole


class GlobalFeatureAttention(nn.Module):
    """A codeword (B, 1024) from a scan's features (B, channels, N): equations 4 and 5.

    beta_ij = softmax over i of f(x_i) . g(x_j);  r_j = sum_i beta_ij h(x_i);  o = max of a shared network on [x, r]
    """

    def __init__(self, channels: int, codeword: int = CODEWORD) -> None:
        super().__init__()
        self.f, self.g = (nn.Conv1d(channels, channels // 8, 1) for _ in range(2))
        self.h = nn.Conv1d(channels, channels, 1)
        self.after = _shared(2 * channels, codeword, flat=True)

    def attention(self, features: Tensor) -> Tensor:
        """(B, N, N) beta; each column j sums to 1 over i."""
        return torch.softmax(torch.bmm(self.f(features).transpose(1, 2), self.g(features)), dim=1)

    def forward(self, features: Tensor) -> Tensor:
        """The codeword."""
        looked = torch.bmm(self.h(features), self.attention(features))
        codeword: Tensor = self.after(torch.cat([features, looked], 1)).amax(dim=2)
        return codeword


class PocoNet(nn.Module):
    """Logits (B, 3, N) of low, high and ground, and the codeword (B, 1024)."""

    def __init__(self, dropout: float = 0.5) -> None:
        super().__init__()
        self.first = _shared(4, 8, flat=True)
        self.stages = nn.ModuleList()
        widths, channels = [], 8
        for out in STAGES:
            self.stages.append(LocalAggregation(channels, out))
            channels = 2 * out
            widths.append(channels)
        self.attention = GlobalFeatureAttention(channels)
        self.bottom = _shared(channels + CODEWORD, channels, flat=True)
        skips = [widths[0], *widths[:-1]]  # inputs of the stages; the first stage's output for the last upsampling
        self.back = nn.ModuleList()
        for skip in reversed(skips):
            self.back.append(_shared(channels + skip, skip, flat=True))
            channels = skip
        self.head = nn.Sequential(
            _shared(channels, 64, flat=True), _shared(64, 32, flat=True), nn.Dropout(dropout), nn.Conv1d(32, CLASSES, 1)
        )

    def forward(
        self, features: Tensor, points: list[Tensor], near: list[Tensor], kept: list[Tensor], up: list[Tensor]
    ) -> tuple[Tensor, Tensor]:
        """features: (B, 4, N): x y z intensity. For each of the four stages: points (B, 3, N_s), near (B, N_s, 12),
        kept (B, N_s+1): indices of the kept points, up (B, N_s): for each point the nearest kept one."""
        found, skips = self._encoded(features, points, near, kept)
        codeword = self.attention(found)
        wide = codeword.unsqueeze(2).expand(-1, -1, found.shape[2])
        found = self.bottom(torch.cat([found, wide], 1))
        for layer, nearest, skip in zip(self.back, reversed(up), reversed(skips[:-1]), strict=True):
            found = layer(torch.cat([gathered(found, nearest), skip], 1))
        return self.head(found), codeword

    def codeword(self, features: Tensor, points: list[Tensor], near: list[Tensor], kept: list[Tensor]) -> Tensor:
        """The codeword alone: all that training asks of the second branch."""
        found: Tensor = self.attention(self._encoded(features, points, near, kept)[0])
        return found

    def _encoded(
        self, features: Tensor, points: list[Tensor], near: list[Tensor], kept: list[Tensor]
    ) -> tuple[Tensor, list[Tensor]]:
        """Features after the last stage, and those that go beside to the way back."""
        found = self.first(features)
        skips = []
        for stage, (layer, at, around, going) in enumerate(zip(self.stages, points, near, kept, strict=True)):
            beside = around.transpose(1, 2).contiguous()  # neighbours before points: sums over them read whole rows
            found = layer(found, at, beside)
            if stage == 0:
                skips.append(found)
            neighbourhood = torch.gather(beside, 2, going.unsqueeze(1).expand(-1, beside.shape[1], -1))
            found = gathered(found, neighbourhood).amax(dim=2)
            skips.append(found)
        return found, skips

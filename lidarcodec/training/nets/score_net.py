"""ScoreNet: scores from a range image, small enough for a vehicle: 0.1 M parameters, 0.2 G multiplications a turn.

A U-Net of depthwise 3 x 5 and pointwise convolutions. Its first layer takes patches of 2 x 4 pixels, so no layer runs
at the full width, and the output has the scores of a patch's pixels as channels. A shortcut passes the pixels
themselves to the head. Five values for each pixel: low, high, ground (logits), rank of the count (a logit), rarely
seen (a logit).
"""

from __future__ import annotations

from typing import Final

import torch
from torch import Tensor, nn

from lidarcodec.reduction.score_image import CHANNELS, PATCH

VALUES: Final = 5
LOW, HIGH, GROUND, RANK, SELDOM = range(VALUES)
WIDTHS: Final = (32, 64, 104)


class _Block(nn.Module):
    """Depthwise and pointwise convolution, twice, with a shortcut."""

    def __init__(self, channels: int, out: int) -> None:
        super().__init__()
        self.body = nn.Sequential(*_separable(channels, out), *_separable(out, out))
        self.short = nn.Identity() if channels == out else nn.Conv2d(channels, out, 1, bias=False)

    def forward(self, x: Tensor) -> Tensor:
        """(B, out, H, W) from (B, channels, H, W)."""
        found: Tensor = self.body(x) + self.short(x)
        return found


def _separable(channels: int, out: int) -> list[nn.Module]:
    return [
        nn.Conv2d(channels, channels, (3, 5), padding=(1, 2), groups=channels, bias=False),
        nn.Conv2d(channels, out, 1, bias=False),
        nn.BatchNorm2d(out),
        nn.ReLU(inplace=True),
    ]


class ScoreNet(nn.Module):
    """(B, 5 * 8, H / 2, C / 4) values for the pixels of each patch, from features (B, 6, H, C); H is a multiple of 8,
    C of 16.
    """

    def __init__(self, widths: tuple[int, int, int] = WIDTHS) -> None:
        super().__init__()
        first, second, third = widths
        pixels = PATCH[0] * PATCH[1]
        self.patches = nn.Conv2d(CHANNELS, first, PATCH, stride=PATCH)
        self.own = nn.Sequential(nn.Conv2d(CHANNELS, 3 * pixels, PATCH, stride=PATCH), nn.ReLU(inplace=True))
        self.down1, self.down2, self.down3 = _Block(first, first), _Block(first, second), _Block(second, third)
        self.bottom = _Block(third, third)
        self.up2, self.up1 = _Block(third + second, second), _Block(second + first, first)
        self.head = nn.Sequential(
            nn.Conv2d(first + 3 * pixels, 48, 1), nn.ReLU(inplace=True), nn.Conv2d(48, VALUES * pixels, 1)
        )
        self.pool = nn.MaxPool2d(2)
        self.wider = nn.Upsample(scale_factor=2, mode="nearest")

    def forward(self, features: Tensor) -> Tensor:
        """The values, patch by patch; `unpatched` of lidarcodec.reduction.score_image makes them an image."""
        own = self.own(features)
        one = self.down1(self.patches(features))
        two = self.down2(self.pool(one))
        three = self.bottom(self.down3(self.pool(two)))
        back = self.up2(torch.cat([self.wider(three), two], 1))
        back = self.up1(torch.cat([self.wider(back), one], 1))
        values: Tensor = self.head(torch.cat([back, own], 1))
        return values


def in_place(values: Tensor) -> Tensor:
    """(B, 5, H, C) from the network's (B, 5 * 8, H / 2, C / 4)."""
    rows, columns = PATCH
    batch, _, height, width = values.shape
    placed = values.reshape(batch, VALUES, rows, columns, height, width).permute(0, 1, 4, 2, 5, 3)
    whole: Tensor = placed.reshape(batch, VALUES, height * rows, width * columns)
    return whole

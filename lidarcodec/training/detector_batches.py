"""What the detector is to answer to views of examples, in torch: all examples lie on the device that trains.

A view is turned, mirrored, and a little larger or smaller by chance. It is the one of detector/view.py.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
import torch
from torch import Tensor

from lidarcodec.evaluation.detection.detector.network import KINDS
from lidarcodec.evaluation.detection.detector.view import (
    CELL_M,
    CELLS,
    CHANNELS,
    COUNTED_DEG,
    DEPTH_M,
    FARTHEST_M,
    HALF_DEG,
    LAYER_M,
    LAYERS,
    LOWEST_M,
    MARGIN_M,
    NEAREST_M,
    OUT_CELLS,
    OUT_M,
)
from lidarcodec.training.detector_data import Example

TURN_RAD: Final = 0.2
"""Labels of KITTI are in the view of a camera, so its clouds are turned by little."""
BRIGHTER: Final = (0.6, 1.6)
"""Intensities are multiplied by a number in between, so that a sensor of another gain is understood."""
DARK: Final = 0.3
"""Share of the views without intensity, because a stream may have none."""
SPREAD: Final = 0.3
"""Of the blob around a middle, in widths of the object."""
NEAR: Final = 0.4
"""Cells of a blob above this learn the box, too."""


class Batch(NamedTuple):
    """view: (B, C, 240, 240) as of `seen`; heat: (B, 3, H, W), 1 at the middles; weight: (B, 3, H, W) 0 where anything
    may be found; box: (B, 8, H, W); near: (B, H, W) how much a cell should know the box"""

    view: Tensor
    heat: Tensor
    weight: Tensor
    box: Tensor
    near: Tensor


class _Chance(NamedTuple):
    """Of each view (B,): cosine and sine of its turn, 1 or -1, scale, metres up, factor of intensities."""

    c: Tensor
    s: Tensor
    mirror: Tensor
    scale: Tensor
    up: Tensor
    bright: Tensor

    def moved(self, points: Tensor, of: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """x, y and z of points (N, 3) of the views `of` (N,)."""
        x, y, z = points.unbind(-1)
        scale, c, s = self.scale[of], self.c[of], self.s[of]
        return scale * (c * x - s * y), self.mirror[of] * scale * (s * x + c * y), scale * z + self.up[of]


class Examples:
    """Examples on a device: 2 MB each."""

    def __init__(self, examples: Sequence[Example], device: torch.device) -> None:
        self.device = device
        self._whole = np.array([one.whole for one in examples])
        self._points = _Ragged([one.points for one in examples], device)
        self._intensity = _Ragged([one.intensity for one in examples], device)
        self._boxes = _Ragged([one.boxes for one in examples], device)
        self._kind = _Ragged([one.kind for one in examples], device)

    def __len__(self) -> int:
        return len(self._whole)

    def batch(self, chosen: np.ndarray, rng: np.random.Generator) -> Batch:
        """Views of the examples `chosen` (B,), and what is right there."""
        whole = self._whole[chosen]
        turn = rng.uniform(-1, 1, len(chosen)) * np.where(whole, np.pi, TURN_RAD)
        bright = np.exp(rng.uniform(np.log(BRIGHTER[0]), np.log(BRIGHTER[1]), len(chosen))) * (
            rng.random(len(chosen)) >= DARK
        )
        numbers = (
            np.cos(turn), np.sin(turn), rng.choice((-1.0, 1.0), len(chosen)), rng.uniform(0.95, 1.05, len(chosen)),
            rng.uniform(-0.1, 0.1, len(chosen)), bright,
        )  # fmt: skip
        chance = _Chance(*(torch.tensor(one, dtype=torch.float32, device=self.device) for one in numbers))
        places = torch.from_numpy(chosen).to(self.device)
        points, of = self._points.taken(places)
        view = _view(len(chosen), of, chance.moved(points, of), self._intensity.taken(places)[0] * chance.bright[of])
        known = _known(chance, torch.from_numpy(whole).to(self.device))
        boxes, of_box = self._boxes.taken(places)
        return Batch(view, *_answers(known, of_box, boxes, self._kind.taken(places)[0], chance))


class _Ragged:
    """Arrays of several lengths, one after the other."""

    def __init__(self, parts: Sequence[np.ndarray], device: torch.device) -> None:
        lengths = torch.tensor([len(part) for part in parts], device=device)
        self._values = torch.from_numpy(np.concatenate(parts)).to(device)
        self._lengths, self._starts = lengths, torch.cumsum(lengths, 0) - lengths

    def taken(self, places: Tensor) -> tuple[Tensor, Tensor]:
        """The rows of the parts `places` (B,), and for each row which of them it is of."""
        lengths = self._lengths[places]
        of = torch.repeat_interleave(torch.arange(len(places), device=places.device), lengths)
        ahead = torch.cumsum(lengths, 0) - lengths
        rows = torch.arange(len(of), device=places.device) + (self._starts[places] - ahead)[of]
        return self._values[rows], of


def _view(count: int, of: Tensor, places: tuple[Tensor, Tensor, Tensor], intensity: Tensor) -> Tensor:
    x, y, z = places
    inside = (x > 0) & (x < DEPTH_M) & (y.abs() < DEPTH_M / 2) & (y.abs() < x * math.tan(math.radians(HALF_DEG)))
    inside &= (z >= LOWEST_M) & (z < LOWEST_M + LAYERS * LAYER_M)
    x, y, z, of, intensity = x[inside], y[inside], z[inside], of[inside], intensity[inside]
    cell = (x / CELL_M).long().clamp(max=CELLS - 1) * CELLS + ((y + DEPTH_M / 2) / CELL_M).long().clamp(max=CELLS - 1)
    layer = ((z - LOWEST_M) / LAYER_M).long().clamp(max=LAYERS - 1)
    cells = CELLS * CELLS
    view = torch.zeros(count, CHANNELS, cells, device=x.device)
    view.view(-1)[(of * CHANNELS + layer) * cells + cell] = 1
    flat = of * cells + cell
    view[:, -2] = torch.log1p(torch.bincount(flat, minlength=count * cells).float()).view(count, cells) * 0.4
    brightest = torch.zeros(count * cells, device=x.device)
    brightest.scatter_reduce_(0, flat, intensity.clamp(max=255) / 255, "amax")
    view[:, -1] = brightest.view(count, cells)
    return view.view(count, CHANNELS, CELLS, CELLS)


def _grid(device: torch.device) -> tuple[Tensor, Tensor]:
    """x and y of the middles of the answer's cells, (H, W) each."""
    steps = (torch.arange(OUT_CELLS, device=device) + 0.5) * OUT_M
    x, y = torch.meshgrid(steps, steps - DEPTH_M / 2, indexing="ij")
    return x, y


def _counted(x: Tensor, y: Tensor) -> Tensor:
    far = torch.hypot(x, y)
    ahead = (x > 0) & (y.abs() < x * math.tan(math.radians(COUNTED_DEG)))
    return ahead & (far > NEAREST_M) & (far < FARTHEST_M) & (y.abs() < DEPTH_M / 2 - MARGIN_M)


def _known(chance: _Chance, whole: Tensor) -> Tensor:
    """(B, H, W) which cells are counted, and were labelled before the view was turned."""
    x, y = _grid(whole.device)
    back_y = y * chance.mirror[:, None, None]
    c, s, scale = (part[:, None, None] for part in (chance.c, chance.s, chance.scale))
    before_x, before_y = (c * x + s * back_y) / scale, (c * back_y - s * x) / scale
    return _counted(x, y) & (_counted(before_x, before_y) | whole[:, None, None])


def _answers(
    known: Tensor, of: Tensor, boxes: Tensor, kind: Tensor, chance: _Chance
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """heat, weight, box and near of boxes (M, 7), of the views `of` (M,)."""
    count = len(known)
    x, y, z = chance.moved(boxes[:, :3], of)
    seen = (x > -10) & (x < DEPTH_M + 10) & (y.abs() < DEPTH_M / 2 + 10)
    x, y, z, of, kind, boxes = x[seen], y[seen], z[seen], of[seen], kind[seen], boxes[seen]
    size = boxes[:, 3:6] * chance.scale[of, None]
    turn = torch.atan2(chance.s, chance.c)[of]
    angle = chance.mirror[of] * (boxes[:, 6] + turn)
    heat = torch.zeros(count, len(KINDS), OUT_CELLS, OUT_CELLS, device=known.device)
    weight = known[:, None].float().repeat(1, len(KINDS), 1, 1)
    best = torch.zeros(count, OUT_CELLS, OUT_CELLS, device=known.device)
    target = torch.zeros(count, 8, OUT_CELLS, OUT_CELLS, device=known.device)
    cell_x, cell_y = _grid(known.device)
    values = torch.stack([z, *size.clamp(min=0.1).log().unbind(-1), (2 * angle).sin(), (2 * angle).cos()], dim=-1)
    wanted = (kind >= 0) & _counted(x, y)
    order = torch.cumsum(torch.nn.functional.one_hot(of, count), 0)[torch.arange(len(of), device=of.device), of]
    for turn_of in range(1, int(order.max()) + 1 if len(order) else 0):  # one box of every view at a time
        rows = order == turn_of
        views = of[rows]
        away_x, away_y = x[rows][:, None, None] - cell_x, y[rows][:, None, None] - cell_y
        far = torch.hypot(away_x, away_y)
        left_out = (far < size[rows][:, :1, None] / 2 + OUT_M) & (kind[rows] < 0)[:, None, None]
        weight[views] = weight[views] * ~left_out[:, None]
        spread = torch.clamp(SPREAD * size[rows][:, 1], min=0.8 * OUT_M)[:, None, None]
        blob = torch.exp(-far.square() / (2 * spread.square())) * wanted[rows][:, None, None]
        centre = (blob == blob.amax(dim=(1, 2), keepdim=True)) & (blob > 0)
        shown = torch.where(centre, 1.0, blob)
        number = kind[rows].clamp(min=0)
        heat[views, number] = torch.maximum(heat[views, number], shown)
        weight[views, number] = torch.where(centre, 1.0, weight[views, number])
        closer = ((blob > NEAR) & (blob > best[views])) | centre
        best[views] = torch.where(closer, blob, best[views])
        away = torch.stack([away_x, away_y], dim=1) / OUT_M
        whole = torch.cat([away, values[rows][:, :, None, None].expand(-1, -1, OUT_CELLS, OUT_CELLS)], dim=1)
        target[views] = torch.where(closer[:, None], whole, target[views])
    return heat, weight, target, best

"""The detector's network without torch; its weights in 8 bits.

    view (15, 240, 240) -> 24 x 120 x 120 -> 48 x 60 x 60 -> 80 x 30 x 30, and back up to 120 x 120 by sums
    -> for each cell of 0.4 m: 3 logits of being the middle of a vehicle, cyclist, pedestrian, and 8 numbers of its box

Objects as points: after CenterNet (Zhou et al. 2019) and CenterPoint (Yin et al. 2021), on a view as in PIXOR (Yang et
al. 2018). Batch normalisation is part of the weights and biases here.
"""

from __future__ import annotations

from collections.abc import Mapping
from io import BytesIO
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from lidarcodec.evaluation.detection.detector.view import CHANNELS
from lidarcodec.untrusted import network_weights

SHIPPED: Final = Path(__file__).with_name("detector-sim.npz")
"""Weights of the package, trained on simulated drives."""
KINDS: Final = ("vehicle", "cyclist", "pedestrian")
BOX: Final = 8
"""x and y of the middle from that of the cell in cells, z in metres, logarithms of length, width and height in metres,
sine and cosine of twice the angle."""
Floats = npt.NDArray[np.float32]


class Shape(NamedTuple):
    """Of a convolution. size: 1 or 3 cells; stride: 1 or 2"""

    inputs: int
    outputs: int
    size: int = 3
    stride: int = 1


LAYERS: Final[dict[str, Shape]] = {
    "a0": Shape(CHANNELS, 24, stride=2), "a1": Shape(24, 24),
    "b0": Shape(24, 48, stride=2), "b1": Shape(48, 48), "b2": Shape(48, 48),
    "c0": Shape(48, 80, stride=2), "c1": Shape(80, 80), "c2": Shape(80, 80),
    "up_c": Shape(80, 48, 1), "d": Shape(48, 48), "up_d": Shape(48, 24, 1), "e": Shape(24, 32),
    "out": Shape(32, len(KINDS) + BOX, 1),
}  # fmt: skip
BARE: Final = ("up_c", "up_d", "out")
"""Layers whose values may be negative."""


class Layer(NamedTuple):
    """weights: (outputs, inputs, size, size); bias: (outputs,)"""

    weights: Floats
    bias: Floats


class Network(NamedTuple):
    """layers: those of LAYERS, by name; about: what the weights were trained on, and their licence"""

    layers: Mapping[str, Layer]
    about: Mapping[str, Any]

    def __call__(self, view: Floats) -> Floats:
        """(3 + 8, 120, 120) of a view (15, 240, 240). Cost: 0.1 s of a core."""
        a = self._layer("a1", self._layer("a0", view))
        b = self._layer("b2", self._layer("b1", self._layer("b0", a)))
        c = self._layer("c2", self._layer("c1", self._layer("c0", b)))
        d = self._layer("d", np.maximum(_doubled(self._layer("up_c", c)) + b, 0))
        e = self._layer("e", np.maximum(_doubled(self._layer("up_d", d)) + a, 0))
        return self._layer("out", e)

    def _layer(self, name: str, values: Floats) -> Floats:
        found = convolved(values, self.layers[name], LAYERS[name].stride)
        return found if name in BARE else np.maximum(found, 0)


def convolved(values: Floats, layer: Layer, stride: int) -> Floats:
    """(outputs, H / stride, W / stride) of values (inputs, H, W), with zeros around."""
    outputs, inputs, size, _ = layer.weights.shape
    high, wide = values.shape[1] // stride, values.shape[2] // stride
    edge = size // 2
    around = np.pad(values, ((0, 0), (edge, edge), (edge, edge)))
    found = np.repeat(layer.bias[:, None], high * wide, axis=1)
    for down in range(size):
        for right in range(size):
            part = around[:, down : down + high * stride : stride, right : right + wide * stride : stride]
            found += layer.weights[:, :, down, right] @ part.reshape(inputs, -1)
    return found.reshape(outputs, high, wide)


def _doubled(values: Floats) -> Floats:
    return values.repeat(2, axis=1).repeat(2, axis=2)


def read_network(file: Path | BytesIO, name: str = "the file") -> Network:
    """The network of a file of weights. name: of the file, for errors

    Raises SourceError if it is not one, or cannot be read.
    """
    shapes = {layer: (one.outputs, one.inputs, one.size, one.size) for layer, one in LAYERS.items()}
    layers, about = network_weights.read(file, name, "of a detector", shapes)
    return Network({layer: Layer(*one) for layer, one in layers.items()}, about)

"""PointNet as Zhang et al. use it to choose the points of a map, without torch; its weights in 8 bits.

    points (1024, 3) -> T1 (3 x 3) -> 64 -> 128 -> 128 -> T2 (128 x 128) -> 512 -> 2048 -> maximum over all points
    that and 64 + 128 + 128 + 128 + 512 of each point, 3,008 values -> 256 -> 256 -> 128 -> 1 logit of being kept

T1 and T2 are found by small networks of the same kind: layers of each point, the maximum, layers of that. Their widths
are not printed; ours are in LAYERS. Batch normalisation is part of the weights and biases here.
"""

from __future__ import annotations

from collections.abc import Mapping
from io import BytesIO
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from lidarcodec.untrusted import network_weights

Floats = npt.NDArray[np.float32]

LAYERS: Final[dict[str, tuple[int, int]]] = {
    "t1_a": (3, 64), "t1_b": (64, 128), "t1_c": (128, 512), "t1_d": (512, 128), "t1_e": (128, 9),
    "a": (3, 64), "b": (64, 128), "c": (128, 128),
    "t2_a": (128, 64), "t2_b": (64, 128), "t2_c": (128, 512), "t2_d": (512, 64), "t2_e": (64, 128 * 128),
    "d": (128, 512), "e": (512, 2048),
    "whole": (2048, 256), "own": (960, 256), "f": (256, 256), "g": (256, 128), "out": (128, 1),
}  # fmt: skip
"""Inputs and outputs of each layer. `whole` and `own` are one layer of 3,008 inputs: what all points share is computed
once."""


class Layer(NamedTuple):
    """weights: (outputs, inputs); bias: (outputs,)"""

    weights: Floats
    bias: Floats


class PointNet(NamedTuple):
    """layers: those of LAYERS, by name; about: what the weights were trained on, and their licence"""

    layers: Mapping[str, Layer]
    about: Mapping[str, Any]

    def logits(self, window: Floats) -> Floats:
        """(1024,) how much each point of a window (1024, 3) should be kept. About 0.1 s of a core."""
        moved = window @ self._transform("t1", window, 3)
        a = self._layer("a", moved)
        b = self._layer("b", a)
        c = self._layer("c", b)
        turned = c @ self._transform("t2", c, 128)
        d = self._layer("d", turned)
        whole = self._layer("e", d).max(axis=0)
        own = self._linear("own", np.concatenate([a, b, c, turned, d], axis=1))
        hidden = np.maximum(own + self._linear("whole", whole), 0)
        found: Floats = self._linear("out", self._layer("g", self._layer("f", hidden)))[:, 0]
        return found

    def _linear(self, name: str, values: Floats) -> Floats:
        layer = self.layers[name]
        return values @ layer.weights.T + layer.bias

    def _layer(self, name: str, values: Floats) -> Floats:
        return np.maximum(self._linear(name, values), 0)

    def _transform(self, name: str, values: Floats, size: int) -> Floats:
        for part in "abc":
            values = self._layer(f"{name}_{part}", values)
        flat = self._linear(f"{name}_e", self._layer(f"{name}_d", values.max(axis=0)))
        return flat.reshape(size, size) + np.eye(size, dtype=np.float32)


def read_point_net(file: Path | BytesIO, name: str = "the file") -> PointNet:
    """The network of a file of weights. name: of the file, for errors

    Raises SourceError if it is not one, or cannot be read.
    """
    shapes = {layer: (outputs, inputs) for layer, (inputs, outputs) in LAYERS.items()}
    layers, about = network_weights.read(file, name, "for maps", shapes)
    return PointNet({layer: Layer(*one) for layer, one in layers.items()}, about)

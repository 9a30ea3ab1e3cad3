"""Files of the weights of a network's layers, 8 bits each, with what they were trained on and their licence.

An `.npz` with `about` (JSON), and for each layer `NAME.weights` (outputs, ...) int8, `NAME.scale` and `NAME.bias`
(outputs,) float32.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from io import BytesIO
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from lidarcodec.budgets import largest
from lidarcodec.errors import SourceError
from lidarcodec.untrusted.json import JsonRefusedError, read_object
from lidarcodec.untrusted.npz import ArraysRefusedError, read_npz

MAX_FILE: Final = largest("weights") or 0
MAX_ABOUT: Final = 1 << 16
Floats = npt.NDArray[np.float32]
Layers = Mapping[str, tuple[Floats, Floats]]
"""Weights (outputs, ...) and bias (outputs,) by the name of their layer."""


def packed(layers: Layers, about: Mapping[str, Any], names: Iterable[str]) -> bytes:
    """The bytes of a file, with a scale for each output. names: of the layers that it must have

    Raises KeyError for a layer that is missing.
    """
    arrays: dict[str, Any] = {}
    for name in names:
        weights, bias = layers[name]
        flat = weights.reshape(len(weights), -1)
        scale = np.maximum(np.abs(flat).max(axis=1), 1e-12).astype(np.float32) / 127
        arrays |= {
            f"{name}.weights": np.rint(flat / scale[:, None]).astype(np.int8).reshape(weights.shape),
            f"{name}.scale": scale,
            f"{name}.bias": bias.astype(np.float32),
        }
    text = json.dumps(dict(about), ensure_ascii=False, sort_keys=True).encode()
    file = BytesIO()
    np.savez_compressed(file, about=np.frombuffer(text, np.uint8), **arrays)
    return file.getvalue()


def read(
    file: Path | BytesIO, name: str, use: str, shapes: Mapping[str, tuple[int, ...]]
) -> tuple[Layers, Mapping[str, Any]]:
    """The layers of a file, and what it says about them. name: of the file; use: what the weights are for, for errors
    shapes: of the weights of each layer

    Raises SourceError if the file cannot be read, or is not one of these layers.
    """
    try:
        arrays = read_npz(file, most_bytes=MAX_FILE)
        about = read_object(arrays["about"].tobytes(), MAX_ABOUT)
        return {layer: _layer_of(arrays, layer, shape) for layer, shape in shapes.items()}, about
    except OSError as error:
        raise SourceError(f"cannot read the weights {name}: {error.strerror or error}") from None
    except KeyError as error:
        raise SourceError(f"{name} is not a file of weights {use}: {error.args[0]} is missing") from None
    except (ArraysRefusedError, JsonRefusedError, ValueError) as error:
        raise SourceError(f"{name} is not a file of weights {use}: {error}") from None


def _layer_of(arrays: Mapping[str, npt.NDArray[Any]], name: str, shape: tuple[int, ...]) -> tuple[Floats, Floats]:
    kinds = {"weights": (np.int8, shape), "scale": (np.float32, shape[:1]), "bias": (np.float32, shape[:1])}
    for part, (kind, wanted) in kinds.items():
        found = arrays[f"{name}.{part}"]
        if found.dtype != kind or found.shape != wanted or not np.isfinite(found).all():
            raise ValueError(f"{name}.{part} is not {wanted} finite values of {np.dtype(kind)}")
    weights, scale, bias = (arrays[f"{name}.{part}"] for part in kinds)
    return weights.astype(np.float32) * scale.reshape(-1, *[1] * (len(shape) - 1)), bias

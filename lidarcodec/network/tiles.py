"""Weights of a layer in tiles of sixteen sums and four inputs: files and processors leave out those that are empty."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from lidarcodec.errors import SectionError

SUMS: Final = 16
INPUTS: Final = 4

Weights = npt.NDArray[np.int16]


def _in_tiles(weights: Weights) -> Weights:
    """(blocks, inputs / 4, 16, 4) of (out, inputs), the last block filled up with 0."""
    out, inputs = weights.shape
    filled = np.zeros((-(-out // SUMS) * SUMS, inputs), weights.dtype)
    filled[:out] = weights
    return filled.reshape(-1, SUMS, inputs // INPUTS, INPUTS).swapaxes(1, 2)


def tiles_left(weights: Weights) -> npt.NDArray[np.bool_]:
    """(blocks, inputs / 4): which tiles have weights. weights: (out, inputs)"""
    left: npt.NDArray[np.bool_] = np.asarray(_in_tiles(weights).any(axis=(2, 3)))
    return left


def packed(weights: Weights, dtype: str) -> bytes:
    """Which tiles there are, a bit each, and their weights."""
    left = tiles_left(weights)
    return np.packbits(left, bitorder="little").tobytes() + _in_tiles(weights)[left].astype(dtype).tobytes()


def unpacked(take: Callable[[int], bytes], shape: tuple[int, int], dtype: str) -> Weights:
    """(out, inputs), from anybody. take: gives so many bytes. Raises SectionError, or what `take` does."""
    out, inputs = shape
    blocks, across = -(-out // SUMS), inputs // INPUTS
    bits = np.unpackbits(np.frombuffer(take(-(-blocks * across // 8)), np.uint8), bitorder="little").astype(bool)
    left = bits[: blocks * across].reshape(blocks, across)
    count, of_tile = int(np.count_nonzero(left)), SUMS * INPUTS
    found: npt.NDArray[Any] = np.frombuffer(take(count * of_tile * np.dtype(dtype).itemsize), dtype)
    tiles = np.zeros((blocks, across, SUMS, INPUTS), np.int16)
    tiles[left] = found.reshape(count, SUMS, INPUTS)
    weights = tiles.swapaxes(1, 2).reshape(blocks * SUMS, inputs)
    if bits[left.size :].any() or left.all() or weights[out:].any() or not np.array_equal(tiles_left(weights), left):
        raise SectionError("a layer whose tiles are not those that have weights")
    return weights[:out]

"""Damaged weights of codec `riddle`: files, and updates of files that the reader has."""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from lidarcodec._native import crc32c
from lidarcodec.errors import MissingReferenceError
from lidarcodec.network.networks import CASES, Layer, Net, Weights
from lidarcodec.network.shelf import weights_of
from lidarcodec.network.update import applied, is_update, update_of, weights_with
from lidarcodec.network.weight_file import unpack_weights
from tests.fuzz.mutations import mutated


def weights_target() -> Callable[[random.Random], tuple[bytes, Callable[[bytes], object]]]:
    """Damaged WEIGHTS sections, half of them with a checksum that is right again."""
    base = weights_of("")
    net, numbers = base.net(expects=True, size=0), np.random.default_rng(3)
    layers = [
        Layer((la.weights + numbers.normal(0, 30, la.weights.shape)).astype(np.int16), la.bias, la.shift)
        for la in net.layers
    ]
    cases = numbers.integers(-60, 60, (CASES, len(layers[0].bias))).astype(np.int8)
    first = replace(layers[0], cases=cases)
    update = update_of(base, [Net(True, 0, (first, layers[1], layers[2]))], (5, 6, 6, 5))
    few = first.weights.copy()
    few[16:, :80] = 0
    sparse = Net(True, 0, (replace(first, weights=few), layers[1], layers[2]))
    clean = (update.data, weights_with([net]).data, update.weights.data, weights_with([sparse]).data)

    def find(name: str) -> Weights:
        if name == base.name:
            return base
        raise MissingReferenceError(f"weights {name} have not arrived yet", 1)

    def take(given: bytes) -> Weights:
        return applied(given, find) if is_update(given) else unpack_weights(given)

    def case(rng: random.Random) -> tuple[bytes, Callable[[bytes], object]]:
        data = mutated(rng.choice(clean), rng)
        if rng.random() < 0.5 and len(data) > 4:
            data = data[:-4] + int(crc32c(data[:-4])).to_bytes(4, "little")
        return data, take

    return case

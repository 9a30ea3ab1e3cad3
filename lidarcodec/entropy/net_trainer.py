"""Training of the networks of codec `riddle` in the native core: samples of returns, and steps of Adam on them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
import numpy.typing as npt

from lidarcodec import _native

if TYPE_CHECKING:
    from lidarcodec.entropy.fast import GivenLayer, NativeNets

Taken = tuple[npt.NDArray[np.int8], npt.NDArray[np.uint8], npt.NDArray[np.uint8], npt.NDArray[np.int16]]
"""Of n returns: inputs (n, 72 or 112); leaves (n,); the first three offset bits (n, 3), 255: none; log odds that
contexts said of the four decisions of the leaf and of those bits (n, 7), 32768 for six natural units."""
FloatLayer = tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]

_ALL: Final = 65536
_NO_LIMIT: Final = -1.0
_LAYERS: Final = 3


class ReturnSamples:
    """Some returns of a frame, drawn at random while it is coded: inputs, what came, and what contexts said of it."""

    def __init__(self, share: float, seed: int) -> None:
        """share: of the returns, 0 to 1."""
        self.native = _native.RiddleSamples(min(_ALL, max(0, round(share * _ALL))), seed & 0xFFFFFFFF)

    def __len__(self) -> int:
        return len(self.native)

    @property
    def inputs(self) -> int:
        """Numbers that the network got of each return, 72 or 112."""
        return self.native.inputs

    def taken(self) -> Taken:
        """What was taken, a copy."""
        return self.native.taken()


@dataclass(frozen=True)
class TrainSettings:
    """How a network is trained.

    rate: of Adam
    mean: how much of the running mean stays at each step, at most; beside: how much of what contexts said counts
    batch: samples in a step
    room: samples to learn from, at most, of which newer ones take the places; turns: and how many additions as large as
    the last one they are, at most; held_room: newest ones that are measured on
    """

    rate: float = 1e-3
    mean: float = 0.99
    beside: float = 1.0
    batch: int = 256
    room: int = 1 << 16
    turns: int = 1024
    held_room: int = 1 << 14


class NetTrainer:
    """Goes on training a network. The same samples, seed and steps give the same network on every machine.

    Raises SectionError for layers that are no network, SettingsError for settings out of range.
    """

    def __init__(self, layers: Sequence[GivenLayer], settings: TrainSettings, seed: int) -> None:
        first, second, third = layers
        s = settings
        self._native = _native.RiddleTrainer(
            *first, *second, *third,
            s.rate, s.mean, s.beside, s.batch, s.room, s.turns, s.held_room, seed & 0xFFFFFFFF,
        )  # fmt: skip

    def add(self, samples: ReturnSamples, *, held: bool) -> None:
        """Takes samples; held: to measure on, never to learn from. Raises SectionError for those of another network."""
        self._native.add(samples.native, held)

    def train(self, steps: int, budget_ms: float | None = None) -> int:
        """Steps taken: so many at most, and none begun after so long; none while there are too few samples."""
        return self._native.train(steps, _NO_LIMIT if budget_ms is None else max(0.0, budget_ms))

    def layers(self) -> list[FloatLayer]:
        """Weights (out, in) and biases (out,) of each layer: the mean of the last steps."""
        return [self._native.layer(number) for number in range(_LAYERS)]

    def cases(self) -> npt.NDArray[np.float32]:
        """(96, out) biases of rows and scales in the first layer: the mean of the last steps."""
        return self._native.conditional_bias()

    def cost(self, nets: NativeNets, beside: float) -> float:
        """Bits of a held sample under a network, mean. beside: how much of what contexts said counts."""
        return self._native.cost(nets.native, beside)

    @property
    def samples(self) -> int:
        """To learn from."""
        return self._native.samples

    @property
    def held(self) -> int:
        """To measure on."""
        return self._native.held

    @property
    def steps(self) -> int:
        """Taken so far."""
        return self._native.steps

"""What every reducer is: a function of its state and a frame, which gives the frame with `keep` set.

>>> Budget(points=9000).of(110_000), Budget(fraction=0.25).of(110_000), Budget(points=9000).of(70)
(9000, 27500, 70)
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from lidarcodec.frame import Frame

DEFAULT_FRACTION: Final = 1 / 12
"""Share of the returns where no budget is set: what PocoNet keeps, about 9,000 of an HDL-64E's frame."""
DEFAULT_SEED: Final = 1

Cells = npt.NDArray[np.uint32]


@dataclass(frozen=True)
class Budget:
    """How many returns of a frame are to stay: a number of them, or a share; a twelfth if neither is given."""

    points: int | None = None
    fraction: float | None = None

    def of(self, returns: int) -> int:
        """Of so many returns: the number, or all if there are fewer; of a share the nearest number, at least one."""
        if self.points is not None:
            return min(self.points, returns)
        share = DEFAULT_FRACTION if self.fraction is None else self.fraction
        return min(max(int(share * returns + 0.5), 1), returns)


class Reducer(ABC):
    """Takes the frames of a stream in order. The same frames after `reset` give the same result, on any machine.

    budget: how many returns stay; may change between two frames
    seed:   decides wherever a choice has to be made between equals
    """

    def __init__(self, budget: Budget, argument: str | None = None, seed: int = DEFAULT_SEED) -> None:
        self.budget, self.argument, self.seed = budget, argument, seed

    @abstractmethod
    def reduce(self, frame: Frame) -> Frame:
        """The frame with `keep` set; as it is when all of it stays."""

    def reset(self) -> None:  # noqa: B027 (most remember nothing)
        """Forget earlier frames."""

    def report(self) -> dict[str, Any]:
        """What a status says of the reducer beside its name and counts."""
        return {}


class Reduction(NamedTuple):
    """What a reducer's file offers to the table, as `REDUCTION`.

    make:     gives a reducer of (budget, argument, seed)
    argument: None, or what stands behind the colon of its name: raises ValueError, saying why, if that cannot be
    budgeted: whether `keep_points` and `keep_fraction` mean anything to it
    note:     what an operator has to know before choosing it; told in the status
    """

    make: Callable[[Budget, str | None, int], Reducer]
    argument: Callable[[str], object] | None = None
    budgeted: bool = True
    note: str | None = None


def with_kept(frame: Frame, cells: Cells) -> Frame:
    """The frame, of which these cells are kept: row * W + column each, (N,) uint32."""
    keep = np.zeros(frame.range.size, np.bool_)
    keep[cells] = True
    return frame.with_(keep=keep.reshape(frame.range.shape))

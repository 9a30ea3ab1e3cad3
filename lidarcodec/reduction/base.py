"""The interface of reducers: a reducer takes a frame and returns it with `keep` set. It may have state.

>>> Budget(points=9000).of(110_000), Budget(fraction=0.25).of(110_000), Budget(points=9000).of(70)
(9000, 27500, 70)
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from lidarcodec.frame import Frame

DEFAULT_FRACTION: Final = 1 / 12
"""Share of the returns without a budget: that of PocoNet, about 9,000 of an HDL-64E's frame."""
DEFAULT_SEED: Final = 1

Cells = npt.NDArray[np.uint32]


@dataclass(frozen=True)
class Budget:
    """The number of returns to keep of a frame: a number, or a share; a twelfth if neither is given."""

    points: int | None = None
    fraction: float | None = None

    def of(self, returns: int) -> int:
        """The number of kept returns out of `returns`: all if there are fewer; a share is rounded, and at least one."""
        if self.points is not None:
            return min(self.points, returns)
        share = DEFAULT_FRACTION if self.fraction is None else self.fraction
        return min(max(int(share * returns + 0.5), 1), returns)


class Reducer(ABC):
    """Takes the frames of a stream in order. The same frames after `reset` give the same result, on any machine.

    budget: how many returns are kept; may change between two frames
    seed:   seed of random choices between equally good returns
    """

    def __init__(self, budget: Budget, argument: str | None = None, seed: int = DEFAULT_SEED) -> None:
        self.budget, self.argument, self.seed = budget, argument, seed

    @abstractmethod
    def reduce(self, frame: Frame) -> Frame:
        """The frame with `keep` set; the frame itself if all of it is kept."""

    def reset(self) -> None:  # noqa: B027 (most have no state)
        """Forget earlier frames."""

    def report(self) -> dict[str, Any]:
        """Further fields of the reducer in the status, besides its name and counts."""
        return {}


class Reduction(NamedTuple):
    """The entry of a reducer in the table: each file has one as `REDUCTION`.

    make:     makes a reducer from (budget, argument, seed)
    argument: checks the text after the colon in its name, and raises ValueError with the reason; None: no argument
    example:  an argument for pages and tests; None: no argument
    budgeted: whether the reducer uses `keep_points` and `keep_fraction`
    note:     a warning for operators, shown in the status
    """

    make: Callable[[Budget, str | None, int], Reducer]
    argument: Callable[[str], object] | None = None
    example: str | None = None
    budgeted: bool = True
    note: str | None = None


def every_nth(rule: str, most: int) -> Callable[[str], int]:
    """The check of an argument n, from 1 to `most`: gives the number, or raises ValueError with the rule."""

    def step_of(argument: str) -> int:
        number = int(argument) if re.fullmatch(f"[0-9]{{1,{len(str(most))}}}", argument) else 0
        if not 1 <= number <= most:
            raise ValueError(f"{rule}, with n from 1 to {most}")
        return number

    return step_of


def with_kept(frame: Frame, cells: Cells) -> Frame:
    """The frame with these cells kept: (N,) uint32, row * W + column each."""
    keep = np.zeros(frame.range.size, np.bool_)
    keep[cells] = True
    return frame.with_(keep=keep.reshape(frame.range.shape))

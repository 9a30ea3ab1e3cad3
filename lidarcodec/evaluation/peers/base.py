"""What a peer's file gives: what it is fed with, its one knob, and a function that makes its coder."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from lidarcodec.settings import step_of

Ranges = npt.NDArray[np.uint16]
Floats = npt.NDArray[np.float64]
Feed = Literal["packets", "x y z", "ranges"]

BOUNDS_M = (0.0, 0.01, 0.05, 0.2)


class Coder(NamedTuple):
    """Both ways of a peer. What goes in and comes back, by feed:

    packets: bytes, the payloads of a frame; x y z: (N, 3) float64 metres, ring by ring, in the order of the columns;
    ranges: (64, W) uint16, steps of 2 mm, 0 = no return
    """

    encode: Callable[[Any], bytes]
    decode: Callable[[bytes], Any]


class Peer(NamedTuple):
    """A peer, as `PEER` in its file.

    feed: what it takes; knob: name of what is varied; values: of the knob, coarsest last; packages: distributions that
    it runs on; make: a coder for a value; ordered: whether points come back in the order in which they went in
    """

    feed: Feed
    knob: str
    values: tuple[float, ...]
    packages: tuple[str, ...]
    make: Callable[[float], Coder]
    ordered: bool = True


def to_levels(ranges: Ranges, max_error_m: float) -> Ranges:
    """(64, W) uint16, ranges in steps that keep a bound, 0 = no return: what a lossless coder then gets.

    A return nearer than half a step, a few centimetres, takes the first level, further away than the bound has it.
    """
    step = step_of(max_error_m)
    levels = np.maximum((ranges.astype(np.int32) + step // 2) // step, 1)
    out: Ranges = np.where(ranges > 0, levels, 0).astype(np.uint16)
    return out


def from_levels(levels: Ranges, max_error_m: float) -> Ranges:
    """(64, W) uint16, the ranges that levels stand for."""
    out: Ranges = np.minimum(levels.astype(np.int32) * step_of(max_error_m), 65535).astype(np.uint16)
    return out

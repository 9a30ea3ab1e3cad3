"""The definition of a peer: its input data, its one knob, and a function that makes its coder."""

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
    """Encoder and decoder of a peer. Their data, by feed:

    packets: bytes, the payloads of a frame; x y z: (N, 3) float64 metres, ring by ring, in the order of the columns;
    ranges: (64, W) uint16, steps of 2 mm, 0 = no return
    """

    encode: Callable[[Any], bytes]
    decode: Callable[[bytes], Any]


class Peer(NamedTuple):
    """A peer, as `PEER` in its file.

    feed: kind of its input; knob: name of its varied parameter; values: values of the knob, coarsest last; packages:
    the distributions that it needs; make: makes a coder for a value; ordered: whether decoded points keep their order
    """

    feed: Feed
    knob: str
    values: tuple[float, ...]
    packages: tuple[str, ...]
    make: Callable[[float], Coder]
    ordered: bool = True


def to_levels(ranges: Ranges, max_error_m: float) -> Ranges:
    """(64, W) uint16, ranges quantised with a bound, 0 = no return: the input of a lossless coder.

    A return nearer than half a step (a few centimetres) gets the first level; its error can exceed the bound.
    """
    step = step_of(max_error_m)
    levels = np.maximum((ranges.astype(np.int32) + step // 2) // step, 1)
    out: Ranges = np.where(ranges > 0, levels, 0).astype(np.uint16)
    return out


def from_levels(levels: Ranges, max_error_m: float) -> Ranges:
    """(64, W) uint16, the ranges of quantised levels."""
    out: Ranges = np.minimum(levels.astype(np.int32) * step_of(max_error_m), 65535).astype(np.uint16)
    return out

"""How far the points of one payload are from those of another."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from lidarcodec.errors import DecodeError
from lidarcodec.sensors.clouds.message import read_message


def same_but_near(one: bytes, other: bytes, max_error_m: float) -> bool:
    """Whether two payloads differ in x, y and z alone, and no point is further than `max_error_m` from its own."""
    if one == other:
        return True
    errors = point_errors(one, other)
    return errors is not None and bool(errors.max(initial=0.0) <= max_error_m * (1 + 1e-9))


def point_errors(one: bytes, other: bytes) -> npt.NDArray[np.float64] | None:
    """(N,) metres between each point of a payload and its own in another; None if they differ in more than x, y and z.

    Points whose coordinates are no numbers, or infinite, are at 0 if these are the same bits, else at infinity.
    """
    if len(one) != len(other):
        return None
    try:
        first, second = read_message(one), read_message(other)
    except DecodeError:
        return np.zeros(0) if one == other else None
    axes = [second.head.by_name.get(name) for name in "xyz"]
    if any(axis is None for axis in axes) or one[: first.head.size] != other[: second.head.size]:
        return np.zeros(first.head.points) if one == other else None
    mine, theirs = first.points.copy(), second.points.copy()
    for axis in axes:
        assert axis is not None
        size = np.dtype(axis.kind).itemsize
        mine[:, axis.offset : axis.offset + size] = theirs[:, axis.offset : axis.offset + size] = 0
    same = np.array_equal(mine, theirs) and np.array_equal(first.between, second.between)
    if not same or first.tail != second.tail:
        return None
    if first.xyz is None or second.xyz is None:
        return np.zeros(first.head.points) if one == other else None
    with np.errstate(invalid="ignore", over="ignore"):
        off = first.xyz - second.xyz
        found: npt.NDArray[np.float64] = np.sqrt((off * off).sum(axis=0))
    same_bits = np.ones(len(found), np.bool_)
    for name in "xyz":
        bits = [np.asarray(part.values(name)) for part in (first, second)]
        same_bits &= (bits[0].view(f"u{bits[0].itemsize}") == bits[1].view(f"u{bits[1].itemsize}")).ravel()
    found[same_bits] = 0.0
    found[np.isnan(found)] = np.inf
    return found

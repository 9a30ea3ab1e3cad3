"""The ways to choose points of a map, by name."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from lidarcodec.errors import UnknownNameError
from lidarcodec.maps.points import MapPoints
from lidarcodec.maps.select.greedy import greedy
from lidarcodec.maps.select.plain import random_points, voxel
from lidarcodec.maps.select.programme import paper
from lidarcodec.maps.select.result import Selection

Select = Callable[[MapPoints, int, int], Selection]
"""A function of (points, count, seed): at most `count` points."""
METHODS: Final[dict[str, Select]] = {"greedy": greedy, "paper": paper, "voxel": voxel, "random": random_points}


def method(name: str) -> Select:
    """The function of a name. Raises UnknownNameError."""
    if name not in METHODS:
        raise UnknownNameError("choice of points", name, METHODS)
    return METHODS[name]

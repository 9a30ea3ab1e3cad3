"""The ways to choose points of a map, by name."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Final

from lidarcodec.errors import SettingsError, UnknownNameError
from lidarcodec.maps.points import MapPoints
from lidarcodec.maps.select.greedy import greedy
from lidarcodec.maps.select.information import information
from lidarcodec.maps.select.learned import learned_by
from lidarcodec.maps.select.plain import random_points, voxel
from lidarcodec.maps.select.point_net import read_point_net
from lidarcodec.maps.select.programme import lp, paper
from lidarcodec.maps.select.result import Selection

Select = Callable[[MapPoints, int, int], Selection]
"""A function of (points, count, seed): at most `count` points."""
METHODS: Final[dict[str, Select]] = {
    "greedy": greedy,
    "information": information,
    "paper": paper,
    "lp": lp,
    "voxel": voxel,
    "random": random_points,
}
LEARNED: Final = "learned"
"""The method that needs weights."""


def method(name: str, weights: Path | None = None) -> Select:
    """The function of a name. weights: of the network of `learned`

    Raises UnknownNameError, SettingsError for `learned` without weights and weights without it, SourceError.
    """
    if name != LEARNED and name not in METHODS:
        raise UnknownNameError("choice of points", name, (*METHODS, LEARNED))
    if name != LEARNED and weights is not None:
        raise SettingsError(f"--weights is only for --by learned, not for {name}", "weights")
    if name != LEARNED:
        return METHODS[name]
    if weights is None:
        raise SettingsError("--by learned needs --weights FILE, from `lidarcodec train map-points`", "weights")
    return learned_by(read_point_net(weights, str(weights)))

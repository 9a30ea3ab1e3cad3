"""`learned`: the points that a network would keep most, trained on choices of the programme (`paper`)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from lidarcodec.maps.points import MapPoints
from lidarcodec.maps.select.labels import best
from lidarcodec.maps.select.point_net import PointNet
from lidarcodec.maps.select.result import Selection
from lidarcodec.maps.select.windows import coordinates, windows_of


def learned_by(net: PointNet) -> Callable[[MapPoints, int, int], Selection]:
    """A choice of points by a network. The scores of a map are kept for the next share of the same map."""
    kept: list[tuple[MapPoints, npt.NDArray[np.float32]]] = []

    def select(points: MapPoints, count: int, seed: int) -> Selection:
        del seed
        if not kept or kept[0][0] is not points:
            kept[:] = [(points, scores(points, net))]
        about: dict[str, Any] = {"trained_on": str(net.about.get("trained_on", "unknown maps"))}
        return Selection(points.taken(best(kept[0][1], count)), about)

    return select


def scores(points: MapPoints, net: PointNet) -> npt.NDArray[np.float32]:
    """(N,) how much each point should be kept. Raises SettingsError for a map without its path."""
    found = np.zeros(len(points), np.float32)
    for window in windows_of(points):
        found[window] = net.logits(coordinates(points, window[None])[0])
    return found

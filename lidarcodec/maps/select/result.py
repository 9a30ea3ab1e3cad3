"""Selection: points that were chosen, and what is known of the choice."""

from __future__ import annotations

from typing import Any, NamedTuple

from lidarcodec.errors import SettingsError
from lidarcodec.maps.points import MapPoints


class Selection(NamedTuple):
    """points: those that were chosen; about: plain values for the user, such as the gap of a programme"""

    points: MapPoints
    about: dict[str, Any]


def check_seen(points: MapPoints, by: str) -> None:
    """Raise SettingsError if a map does not say from where its points were seen."""
    if not {"count", "first", "last"} <= points.columns.keys() or not len(points.path):
        raise SettingsError(
            f"--by {by} needs a map from `map build`: a compressed map no longer knows from where its points were seen",
            "by",
        )
    if (
        int(points.columns["last"].max(initial=0)) >= len(points.path)
        or (points.columns["first"] > points.columns["last"]).any()
    ):
        raise SettingsError("the map is damaged: points were seen from places that are not on its path", "by")

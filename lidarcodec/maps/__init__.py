"""Maps for localisation: built from drives, reduced, in small files of tiles (`.lcmap`), and served to vehicles.

`open_map` keeps the tiles of a map around a position, from a file or from the network alike.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from lidarcodec.maps.file import read_map
    from lidarcodec.maps.points import MapPoints
    from lidarcodec.maps.served.opening import open_map
    from lidarcodec.maps.served.tiles import MapTiles

_HOME = {"MapPoints": "points", "MapTiles": "served.tiles", "open_map": "served.opening", "read_map": "file"}
"""Where each public name lives; it is imported on first use."""

__all__ = ["MapPoints", "MapTiles", "open_map", "read_map"]


def __getattr__(name: str) -> Any:
    home = _HOME.get(name)
    if home is None:
        raise AttributeError(f"module 'lidarcodec.maps' has no attribute '{name}'")
    return getattr(import_module(f"lidarcodec.maps.{home}"), name)

"""open_map: the tiles of a map around a position, from a file or from the network alike.

>>> from tempfile import TemporaryDirectory
>>> import numpy as np
>>> from lidarcodec.maps.file import write_map
>>> from lidarcodec.maps.points import MapPoints
>>> with TemporaryDirectory() as folder:
...     path = Path(folder) / "town.lcmap"
...     with path.open("w+b") as file:
...         write_map(file, MapPoints(0.02, np.array([[0, 0, 0], [10, 0, 1], [50_000, 0, 0]])))
...     with open_map(path, radius_m=100.0) as town:
...         town.move(5.0, 5.0)
...         town.wait(10.0), len(town.places), len(town.points())
(True, 2, 2)
"""

from __future__ import annotations

import math
import threading
from pathlib import Path

from lidarcodec.maps.served.shelf import ENDING
from lidarcodec.maps.served.sources import FileTiles, NetworkTiles
from lidarcodec.maps.served.stores import FolderPieces, MemoryPieces
from lidarcodec.maps.served.tiles import MapTiles
from lidarcodec.transport import Endpoints, Transport, open_transport


def open_map(
    where: str | Path,
    *,
    radius_m: float = 150.0,
    endpoints: Endpoints | None = None,
    transport: Transport | None = None,
    cache: Path | None = None,
    max_cache_bytes: int = 1 << 30,
    max_points: int = 5_000_000,
    in_flight: int = 4,
    patience_s: float = 10.0,
) -> MapTiles:
    """The tiles of a map around a position that `move` sets.

    where: a file that ends in `.lcmap`, or the name of a map that is served on the network
    endpoints: of the network; by default this machine's. transport: an open session instead; the caller closes it
    cache: folder for coded tiles of at most `max_cache_bytes`, of which none is fetched again; without one they stay in
    memory
    radius_m, max_points, in_flight: see MapTiles
    patience_s: how long the network is waited for, then the list of tiles, and later the path

    Raises SourceError if there is no such map, TransportError, SettingsError.
    """
    options = {"radius_m": radius_m, "max_points": max_points, "in_flight": in_flight, "patience_s": patience_s}
    path = Path(where)
    if path.suffix.lower() == ENDING:
        return MapTiles(FileTiles(path), **options)  # type: ignore[arg-type]
    store = MemoryPieces(max_cache_bytes) if cache is None else FolderPieces(cache, max_cache_bytes)
    session = transport or _opened(endpoints, patience_s)
    closing = session.close if transport is None else lambda: None
    try:
        source = NetworkTiles(str(where), lambda: session, store, patience_s)
        tiles = MapTiles(source, closing=closing, **options)  # type: ignore[arg-type]
    except BaseException:
        closing()
        raise
    source.patience_s = math.inf  # the vehicle drives on, and the network comes back
    return tiles


def _opened(endpoints: Endpoints | None, patience_s: float) -> Transport:
    """A session; one that must reach a router tries for so long. Raises TransportError."""
    stop = threading.Event()
    timer = threading.Timer(patience_s, stop.set)
    timer.start()
    try:
        return open_transport(endpoints, stop=stop)
    finally:
        timer.cancel()

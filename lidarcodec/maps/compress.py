"""compress: a map with fewer points, by a share of them or by the bytes of its file."""

from __future__ import annotations

from dataclasses import replace
from io import BytesIO
from typing import Any, Final

import numpy as np

from lidarcodec.errors import SettingsError
from lidarcodec.maps.file import write_map
from lidarcodec.maps.points import MapPoints
from lidarcodec.maps.select.table import Select, method

FEWEST: Final = 100
_TRIES: Final = 8
_CLOSE: Final = 0.01


def compressed(
    points: MapPoints, by: str, count: int, seed: int = 1, select: Select | None = None
) -> tuple[MapPoints, dict[str, Any]]:
    """At most `count` points by a method, without counts and path, and what is known of the choice.

    select: the method of that name, if it is not that of the table

    Raises SettingsError, UnknownNameError, MissingExtraError.
    """
    if len(points) < FEWEST:
        raise SettingsError(f"the map has {len(points)} points: fewer than {FEWEST} are too few for localisation")
    if count < FEWEST:
        raise SettingsError(f"a map of fewer than {FEWEST} points is too small for localisation", "keep")
    found = (select or method(by))(points, min(count, len(points)), seed)
    return bare(found.points), {"by": by, "points": len(found.points), **found.about}


def bare(points: MapPoints) -> MapPoints:
    """A map with positions and normals only."""
    return replace(points.with_columns("normal_a", "normal_b"), path=np.empty((0, 3), np.float32))


def fitted(
    points: MapPoints, by: str, size: int, seed: int = 1, select: Select | None = None
) -> tuple[MapPoints, dict[str, Any]]:
    """As `compressed`, with as many points as a file of `size` bytes holds, to about one percent.

    Raises SettingsError if even 100 points do not fit.
    """
    count = max(min(size // 3, len(points)), FEWEST)
    best: tuple[MapPoints, dict[str, Any]] | None = None
    low, high = FEWEST, len(points) + 1
    for _ in range(_TRIES):
        made, about = compressed(points, by, count, seed, select)
        bytes_ = file_bytes(made)
        if bytes_ <= size:
            low = max(low, count)
            if best is None or len(made) > len(best[0]):
                best = made, about
            if bytes_ > (1 - _CLOSE) * size or count == len(points):
                break
        else:
            high = min(high, count)
        count = min(max(int(count * (1 - _CLOSE / 3) * size / bytes_), low + 1), high - 1, len(points))
        if count < FEWEST or (count <= low and best is not None):
            break
    if best is None:
        raise SettingsError(f"no map of at least {FEWEST} points fits into {size} bytes", "bytes")
    return best


def file_bytes(points: MapPoints) -> int:
    """Bytes of a map's file."""
    file = BytesIO()
    write_map(file, points)
    return file.tell()

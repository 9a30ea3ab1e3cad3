"""JSON of `map` and its subcommands."""

from __future__ import annotations

from typing import Annotated, NotRequired

from typing_extensions import TypedDict


class MapBuilt(TypedDict):
    """Of `map build`."""

    output: Annotated[str, "the map"]
    scans: Annotated[int, "scans in it"]
    length_m: Annotated[float, "length of all drives"]
    points: Annotated[int, "its points"]
    bytes: Annotated[int, "size of the file"]
    moving: Annotated[int, "cells that were left out because more scans saw through them than hit them"]
    seldom: Annotated[int, "cells that were left out because too few scans hit them"]


# A function of typing: one of the fields has the name of a word of Python.
MapCompressed = TypedDict(
    "MapCompressed",
    {
        "output": Annotated[str, "the map"],
        "bytes": Annotated[int, "size of the file"],
        "by": Annotated[str, "how points were chosen"],
        "points": Annotated[int, "points that were kept"],
        "of": Annotated[int, "points of the input"],
        "cell_m": NotRequired[Annotated[float, "of voxel: width of a cell"]],
        "b": NotRequired[Annotated[float, "of lp: points that each place should see"]],
        "lambda": NotRequired[Annotated[float, "of lp: price of a point that a place lacks"]],
        "gap": NotRequired[Annotated[float, "of lp: by what share the value lies above a bound below all choices"]],
    },
)
MapCompressed.__doc__ = "A map of `map compress`."


class MapInfo(TypedDict):
    """Of `map info`."""

    points: Annotated[int, "its points"]
    bytes: Annotated[int, "size of the file"]
    bits_per_point: Annotated[float, "of the whole file"]
    length_m: Annotated[float, "length of all drives"]
    bytes_per_km: Annotated[int | None, "over that length"]
    tiles: Annotated[int, "number of tiles"]
    tile_m: Annotated[int, "width of a tile"]
    step_m: Annotated[float, "step of coordinates"]
    columns: Annotated[list[str], "what is known of each point beside its place"]
    frame: Annotated[str, "`local`, or the zone of UTM"]
    origin: Annotated[list[float] | None, "latitude, longitude and heading of the origin, in UTM"]
    least_m: Annotated[list[float] | None, "smallest x, y and z"]
    most_m: Annotated[list[float] | None, "largest x, y and z"]
    path_places: Annotated[int, "places of the sensor's path in the file"]


class MapExported(TypedDict):
    """Of `map export`."""

    output: Annotated[str, "the file"]
    points: Annotated[int, "points in it"]


class MapsServed(TypedDict):
    """Of `map serve`, as soon as it answers, in one line. Nothing is printed at its end."""

    maps: Annotated[list[str], "names of the maps"]


class MapFetched(TypedDict):
    """Of `map fetch`."""

    output: Annotated[str, "the map"]
    map: Annotated[str, "its name where it is served"]
    version: Annotated[str, "SHA-256 of the file that is served"]
    tiles: Annotated[int, "tiles in the output"]
    of: Annotated[int, "tiles of the whole map"]
    points: Annotated[int, "points in the output"]
    bytes: Annotated[int, "size of the output"]
    bytes_received: Annotated[int, "bytes of tiles that came over the network"]

"""JSON of `map` and its subcommands."""

from __future__ import annotations

from typing import Annotated, Any, NotRequired

from typing_extensions import TypedDict


class DriveAligned(TypedDict):
    """A drive that was aligned with the others by its overlap."""

    source: Annotated[str, "the drive"]
    transform: Annotated[list[list[float]], "4 x 4: from the frame of its poses to that of the map"]
    scans: Annotated[int, "its scans that fit the map of the others, of those tried"]
    of: Annotated[int, "its scans that lie in that map, of those tried"]
    overlap: Annotated[float, "share of its way that lies in that map"]
    residual_m: Annotated[float, "by how much those that fit disagree, as a root mean square"]
    residual_deg: Annotated[float, "the same in degrees"]


class MapBuilt(TypedDict):
    """Of `map build`."""

    output: Annotated[str, "the map"]
    scans: Annotated[int, "scans in it"]
    length_m: Annotated[float, "length of all drives"]
    points: Annotated[int, "its points"]
    bytes: Annotated[int, "size of the file"]
    moving: Annotated[int, "cells that were left out because more scans saw through them than hit them"]
    seldom: Annotated[int, "cells that were left out because too few scans hit them"]
    aligned: Annotated[list[DriveAligned], "drives that were aligned by their overlap"]


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
        "b": NotRequired[Annotated[float, "of paper: points that each place should see"]],
        "lambda": NotRequired[Annotated[float, "of paper: price of a point that a place lacks"]],
        "gap": NotRequired[Annotated[float, "of paper: by what share the value lies above a bound below all choices"]],
        "trained_on": NotRequired[Annotated[str, "of learned: training data of the weights"]],
        "seconds": NotRequired[Annotated[float, "of paper: time of the solver and of rounding"]],
    },
)
MapCompressed.__doc__ = "A map of `map compress`."


class TrainedMapPoints(TypedDict):
    """Of `train map-points`."""

    outputs: Annotated[list[str], "the checkpoint and the weights"]
    epochs: Annotated[int, "epochs done"]
    seconds: Annotated[float, "time spent on training, over all runs"]
    tests: Annotated[dict[str, float], "by map: share of the programme's points in the other half that are kept, too"]
    log: Annotated[list[dict[str, Any]], "of each epoch: its number, and the loss on the halves learnt and held out"]


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


class Located(TypedDict):
    """Of `localise`."""

    stream: Annotated[str, "VEHICLE/SENSOR, or the source"]
    map: Annotated[str, "the file of the map, or its name on the network"]
    tiles_received: Annotated[int | None, "tiles of the map that came over the network; null for a file"]
    tile_bytes_received: Annotated[int | None, "bytes of them, of their parts and of the path that came"]
    scans: Annotated[int, "scans taken"]
    tracked: Annotated[int, "scans whose pose was found"]
    state: Annotated[str, "`searching`, `tracking` or `lost`, at the end"]
    first_fix_s: Annotated[float | None, "seconds from the first scan to the first pose; null without one"]
    first_fix_scans: Annotated[int | None, "number of scans until then"]
    lost: Annotated[int, "how often the position was lost"]
    searches: Annotated[int, "searches over the whole map"]
    given_up: Annotated[int, "searches that took too long"]
    hints: Annotated[int, "poses of `odometry` that were tried because none was known"]
    wrong_hints: Annotated[int, "those where the scan did not lie in the map"]
    sigma_m: Annotated[float | None, "median standard deviation of the position, in its worst direction"]
    share: Annotated[float | None, "median share of a scan's returns that lie in the map"]
    pose: Annotated[list[float] | None, "the last pose: the upper three rows of T_world_sensor, row by row"]
    stamp_ns: Annotated[int | None, "its host time"]
    track_ms: Annotated[dict[str, float | None], "processor time to track a scan: p50, p99"]
    process_ms: Annotated[float | None, "processor time of the whole process for each scan, decoding included"]
    damaged_tiles: Annotated[int, "tiles of the map that could not be decoded"]
    output: Annotated[str | None, "of `--out`: the file of poses"]
    received: Annotated[dict[str, Any] | None, "how a live stream was received, as of `subscribe`"]


class FoundInMap(TypedDict):
    """Of `evaluate localisation --map MAP.lcmap`: one drive in one map, with whole or thinned scans."""

    source: Annotated[str, "the drive"]
    map: Annotated[str, "the file of the map"]
    scans: Annotated[str, "`whole`, or `2 %`: of the returns, as the authors of map compression thin them"]
    of: Annotated[int, "scans that were looked for, each from where the one before was found"]
    lost: Annotated[int, "those that ended more than 1 m or 4 degrees off"]
    bad: Annotated[int, "those that ended more than 0.5 m or 2 degrees off"]
    mate_m: Annotated[float | None, "mean distance from the true place, without bad ones"]
    mate_m_error: Annotated[float | None, "its standard error"]
    angle_deg: Annotated[float | None, "mean angle, without bad ones"]
    p95_m: Annotated[float | None, "95th percentile of all distances"]
    errors_m: Annotated[list[float], "distance of each step"]
    errors_deg: Annotated[list[float], "angle of each step"]
    lost_steps: Annotated[list[int], "frames that were lost"]

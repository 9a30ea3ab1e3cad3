"""JSON of `bench` and `evaluate`: lists of objects. Bits and errors are explained in docs/evaluation.md."""

from __future__ import annotations

from typing import Annotated, Any, NotRequired

from typing_extensions import TypedDict


class Benched(TypedDict):
    """One codec and setting of `bench`. `--metrics all`, `--curve` and `--learn` add fields (docs/commands.md)."""

    source: Annotated[str, "the source, as it was given"]
    codec: Annotated[str, "name of the codec, or of a peer"]
    settings: Annotated[dict[str, Any], "all settings, with defaults"]
    frames: Annotated[int, "frames measured"]
    frames_left_out: NotRequired[Annotated[int, "frames left out to keep the target bitrate"]]
    points: Annotated[int, "returns of the original frames"]
    points_per_frame: Annotated[float, "the same for each frame"]
    bits_per_point: Annotated[dict[str, float], "bits divided by returns: each plane, and the total"]
    ratio: Annotated[float | None, "packet bytes divided by message bytes"]
    kbps_at_10hz: Annotated[float, "bitrate of 348 packets ten times a second"]
    rmse_m: Annotated[float | None, "root of the mean squared range error, in metres"]
    max_error_m: Annotated[float | None, "largest range error, in metres"]
    psnr_db: Annotated[float | None, "PSNR of ranges with a peak of 130 m; null if they are exact"]
    kept_fraction: Annotated[float | None, "share of the returns that stay"]
    lost: Annotated[int | None, "returns that decoding lost"]
    invented: Annotated[int | None, "returns that the original does not have"]
    bits_per_kept_point: Annotated[float | None, "bits divided by the returns that stay"]
    kb_per_frame: Annotated[float, "kilobytes of a frame"]
    packets_identical: Annotated[bool | None, "whether the packets come back byte for byte"]
    calibration: Annotated[dict[str, str], "its `origin` and its `hash`"]
    encode_ms: Annotated[dict[str, float], "time to encode a frame: mean, p50, p99"]
    decode_ms: Annotated[dict[str, float], "time to decode a frame: mean, p50, p99"]
    version: Annotated[str, "version of this package"]


class Localised(TypedDict):
    """One method on one drive, or on all drives together, of `evaluate localisation`. The results of each kind of test
    are in fields of its name: `track`, `starts`, `near`."""

    source: Annotated[str, "the drive, or the number of drives"]
    reduction: Annotated[str, "name of the reducer"]
    keep_points: Annotated[int | None, "returns kept of each frame"]
    codec: Annotated[str, "name of the codec"]
    settings: Annotated[dict[str, Any], "all settings, with defaults"]
    map: Annotated[str, "`whole` or `own`"]
    receiver: Annotated[str, "`decoded` or `voxel`"]
    localiser: Annotated[str, "`plane` or `vgicp`"]
    points_per_frame: Annotated[float, "returns sent of each frame"]
    bytes_per_frame: Annotated[float, "bytes of a frame"]
    kbps: Annotated[float, "bitrate"]
    map_points: Annotated[float | int, "points of the map"]

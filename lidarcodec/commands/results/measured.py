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
    kbps_at_10hz: Annotated[float, "bitrate of ten turns a second: 348 packets each of an HDL-64E"]
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
    encode_ms: Annotated[dict[str, float], "time to encode a frame, on the cores that are free: mean, p50, p99"]
    decode_ms: Annotated[dict[str, float], "time to decode a frame, the same"]
    version: Annotated[str, "version of this package"]


class Detected(TypedDict):
    """One setting of `evaluate detection`; the first object has the frames as they were read. Errors are
    standard errors by bootstrap over objects. A value is null where nothing was there to be measured."""

    source: Annotated[str, "the drive"]
    recording: NotRequired[Annotated[str, "the recording whose frames were measured"]]
    codec: Annotated[str, "name of the codec; `original` for the frames as they were read"]
    settings: Annotated[dict[str, Any], "all settings, with defaults"]
    failed: NotRequired[Annotated[int, "messages of the recording that could not be decoded"]]
    labels: Annotated[str, "where the boxes are from: `labels` or `simulated`"]
    frames: Annotated[int, "frames of the drive"]
    frames_left_out: Annotated[int, "frames that did not arrive; all of their objects count as lost"]
    fewest_returns: Annotated[int, "objects with fewer returns in the original frame are not counted"]
    points_per_frame: Annotated[float, "returns of each frame that arrived as measured"]
    bytes_per_frame: Annotated[float | None, "bytes of each frame; null for frames that are not coded"]
    kbps: Annotated[float | None, "bitrate"]
    version: Annotated[str, "version of this package"]
    objects: Annotated[int, "boxes that are counted, over all frames"]
    tracks: Annotated[int, "different objects among them"]
    found: Annotated[float | None, "share of the boxes whose object is one cluster, with an IoU above 0.5"]
    found_error: Annotated[float | None, "its error"]
    returns: Annotated[float | None, "returns in a box, as a share of those in the original frame; mean of the boxes"]
    returns_error: Annotated[float | None, "its error"]
    size_error_m: Annotated[float | None, "mean error of length, width and height of the clusters that were found"]
    size_error_m_error: Annotated[float | None, "its error"]
    found_difference: Annotated[float | None, "`found` minus that of the original frames"]
    found_difference_error: Annotated[float | None, "its error"]
    size_error_difference: Annotated[float | None, "`size_error_m` minus that in the original, of boxes found in both"]
    size_error_difference_error: Annotated[float | None, "its error"]
    ground_iou: Annotated[float | None, "IoU of the returns on the ground with those of the original frames"]
    ground_iou_error: Annotated[float | None, "its error, by bootstrap over frames"]
    kinds: Annotated[dict[str, dict[str, Any]], "the fields from `objects` to `size_error_difference_error` by kind"]
    distances: Annotated[dict[str, dict[str, Any]], "the same by distance, such as `15-30` metres"]
    detector: NotRequired[
        Annotated[
            dict[str, dict[str, Any]],
            "of a network, by kind: `objects`, average precision `ap`, `ap_difference` to the original, their errors",
        ]
    ]


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

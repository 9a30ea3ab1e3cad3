"""JSON of commands that work on files. `beside` names files that were written beside an output."""

from __future__ import annotations

from typing import Annotated, Any, NotRequired

from typing_extensions import TypedDict


class Converted(TypedDict):
    """Of a command that writes the frames or packets of a source to an output."""

    output: Annotated[str, "path of what was written; of a stopped command the name of the part that was kept"]
    form: Annotated[str, "format of the output, as in `--as`"]
    files: Annotated[int, "number of files in the output; 1 if it is a file"]
    beside: Annotated[list[str], "files written beside the output: calibration or metadata"]
    frames: Annotated[float | None, "number of frames; null if packets were copied that are not counted in frames"]
    packets: Annotated[int | None, "number of packets; null if points were written"]
    points: Annotated[int | None, "number of points; null if packets were written"]
    positions: Annotated[int, "number of position packets"]
    bytes: Annotated[int | None, "size of a file; null of a folder, a pipe or a device"]
    coded_bytes: NotRequired[Annotated[int, "of a recording: bytes of its messages"]]
    packet_bytes: NotRequired[Annotated[int, "of a recording: bytes of the packets that the messages hold"]]
    source_coded_bytes: NotRequired[Annotated[int, "of a recording that was coded again: bytes of its messages"]]
    ratio: NotRequired[
        Annotated[float, "of a recording: packet bytes divided by coded bytes; of one coded again: source coded bytes"]
    ]
    left_out: NotRequired[
        Annotated[int, "of a recording: how many of `frames` are not in it, to keep the target bitrate"]
    ]
    returns_percent: NotRequired[Annotated[float, "of a recording: returns of its frames that come back, in percent"]]
    largest_error_m: NotRequired[Annotated[float, "of a recording: largest error of a range, in metres"]]
    intensity_rms: NotRequired[
        Annotated[float, "of a recording: root mean square error of the intensities, in units of the sensor"]
    ]
    refinement_bytes: NotRequired[Annotated[int, "of a recording of two layers: bytes of its refinements"]]
    second_returns_left_out: NotRequired[
        Annotated[int, "second returns of the frames, which formats of points do not hold; left out if there are none"]
    ]
    layers: NotRequired[Annotated[dict[str, int], "of two layers: frames refined `whole`, in `part`, or `base` alone"]]


class Piped(TypedDict):
    """Of `pipe`, on standard error."""

    format: Annotated[str, "format of what was written, as in `--to`"]
    frames: Annotated[int, "number of frames passed on"]
    bytes: Annotated[int, "bytes written to standard output"]
    lost: Annotated[int, "messages or frames that could not be passed on"]
    points: NotRequired[Annotated[int, "of `--to points`: number of points"]]
    second_returns_left_out: NotRequired[
        Annotated[int, "of `--to points`: second returns, which are not written; left out if there are none"]
    ]


class Simulated(TypedDict):
    """Of `simulate`."""

    output: Annotated[str, "path of the capture"]
    beside: Annotated[list[str], "the calibration or metadata beside it"]
    packets: Annotated[int, "number of packets"]
    frames: Annotated[float, "number of turns"]


class Fetched(TypedDict):
    """Of `fetch`."""

    output: Annotated[str, "path of the clip"]
    bytes: Annotated[int, "size of the clip"]
    frames: Annotated[int, "number of frames in it"]
    bytes_received: Annotated[int, "bytes that came from the vehicle in this run"]
    gaps: Annotated[list[list[int]], "what the vehicle did not keep: begin and end, in ns since 1970"]
    missing: Annotated[int, "frames missing between those of the clip, by their numbers"]
    holes: Annotated[list[list[int]], "where, the first 1000: stamps of the frames before and after, and how many"]


class Joined(TypedDict):
    """Of `join`."""

    output: Annotated[str, "path of the joined file"]
    beside: Annotated[list[str], "files written beside it"]
    parts: Annotated[int, "number of parts"]
    messages: Annotated[int | None, "number of messages copied; null of captures"]
    packets: Annotated[int | None, "number of packets copied; null of recordings"]
    twice: Annotated[int, "messages of recordings that two parts have, and that were written once"]


class CutOut(TypedDict):
    """Of `cut`."""

    outputs: Annotated[list[str], "paths of the files written, in order"]
    beside: Annotated[list[str], "calibrations written beside captures"]
    messages: Annotated[int | None, "number of messages copied; null of captures"]
    packets: Annotated[int | None, "number of packets copied; null of recordings"]
    earlier_frames: Annotated[int, "frames before the wanted ones, from the key frame on that they need"]


class Verified(TypedDict):
    """Of `verify`."""

    model: Annotated[str, "name of the sensor's model, as in `--model`"]
    frames: Annotated[int, "frames compared"]
    frames_not_in_source: Annotated[int, "frames of the recording whose times the source does not have"]
    packets: Annotated[int, "packets compared"]
    packets_identical: Annotated[bool, "whether all packets are the same, byte for byte"]
    identical_packets: Annotated[int, "number of identical packets"]
    position_packets: Annotated[int, "position packets compared"]
    position_packets_identical: Annotated[bool, "whether all position packets are the same"]
    identical_position_packets: Annotated[int, "number of identical position packets"]
    position_packets_missing: Annotated[int, "position packets of the source that the recording lacks"]
    points: Annotated[int, "returns compared"]
    max_error_m: Annotated[float, "largest range error, in metres"]
    rmse_m: Annotated[float, "root of the mean squared range error, in metres"]
    lost: Annotated[int, "returns that the recording lacks without having been reduced"]
    invented: Annotated[int, "returns that the source does not have"]
    left_out: Annotated[int, "returns left out by reduction"]
    returns_percent: Annotated[float | None, "returns of the compared frames that came back, in percent"]
    intensity_max: Annotated[int | None, "largest difference of an intensity; null if none was compared"]
    intensity_mean: Annotated[float | None, "mean difference of intensities, of returns that came back"]
    sent: Annotated[dict[str, Any], "what its messages say was sent, as of `info`"]
    frames_beyond_their_bound: Annotated[int, "frames with a larger error than their message allows"]
    bounds_m: Annotated[list[float | None], "bounds of the messages, in metres; null for a codec without one"]
    complete: Annotated[bool, "whether the whole recording was compared"]
    interrupted: Annotated[bool, "whether a signal ended the comparison"]
    coverage: Annotated[dict[str, Any] | None, "which part of the source the recording holds; null if interrupted"]
    packets_passed_over: Annotated[int, "packets of the source before, between and after those of the recording"]
    layers: Annotated[
        dict[str, int] | None, "of two layers: frames refined `whole`, in `part`, and of the `base` alone; else null"
    ]
    settings: Annotated[dict[str, Any] | None, "settings in the recording; null if it has none"]
    changed: Annotated[list[Any], "settings that changed while it was recorded"]
    short_turns: Annotated[int, "compared turns that lack columns already in the source"]
    source_lacks: Annotated[str, "these turns, and whole turns that are missing, in a sentence; empty without any"]
    broken: Annotated[list[str], "what is not as promised, a sentence each; the exit code is 1 if there is anything"]
    incomplete: Annotated[
        list[str], "those of `broken` that `--allow-part` accepts: they say nothing against the recording"
    ]


class Labelled(TypedDict):
    """Of `annotate`."""

    folder: Annotated[str, "the output folder"]
    format: Annotated[int, "version of the folder's format"]
    settings: Annotated[dict[str, Any], "settings of the run"]
    sensor: Annotated[dict[str, Any], "the unit, with its calibration"]
    frames: Annotated[int, "number of frames"]
    travelled_m: Annotated[float, "length of the drive, in metres"]
    map_points: Annotated[int, "points of the map"]
    shares: Annotated[dict[str, float], "share of the returns with each label"]
    median_count: Annotated[float, "median of the counts beside the road"]
    median_threshold: Annotated[float, "median of the counts above which a return is labelled high"]
    seconds: Annotated[dict[str, float], "seconds of each stage"]
    done: Annotated[bool, "whether all frames are labelled"]

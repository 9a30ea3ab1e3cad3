"""JSON of live commands: counts and times at their end. docs/live.md explains the fields of a stream's status."""

from __future__ import annotations

from typing import Annotated, Any, NotRequired

from typing_extensions import TypedDict


class Published(TypedDict):
    """Of one stream that `publish` sent: its last status."""

    vehicle: Annotated[str, "name of the vehicle"]
    sensor: Annotated[str, "name of the sensor"]
    frames: Annotated[int, "frames sent"]
    messages: Annotated[int, "messages sent"]
    mean_fps: Annotated[float | None, "frames a second from the first that was sent to the last"]
    bytes: Annotated[int, "bytes sent"]
    key_frames: Annotated[int, "key frames among the messages"]
    replaced: Annotated[int, "frames that a newer one replaced before they were encoded"]
    no_receiver: Annotated[int, "frames that were not encoded, because nobody received"]
    left_out: Annotated[int, "frames left out to keep the target bitrate"]
    settings: Annotated[dict[str, Any], "settings at the end"]
    source: Annotated[dict[str, int], "what the source counted, by kind"]
    recording: Annotated[dict[str, Any] | None, "of `--record`: its last `file`, why it `stopped`, and `counts`"]


class Streams(TypedDict):
    """Of `publish`."""

    streams: Annotated[list[Published], "the status of each stream; docs/live.md has all of its fields"]


class Received(TypedDict):
    """Of `subscribe`. Counts of events that did not happen are left out."""

    stream: Annotated[str, "VEHICLE/SENSOR"]
    frames: NotRequired[Annotated[int, "frames decoded"]]
    bytes: NotRequired[Annotated[int, "bytes received"]]
    missing: NotRequired[Annotated[int, "frames of the publisher that did not come"]]
    fps: Annotated[float | None, "frames a second of the newest 64; null if none came in the last 5 s"]
    mean_fps: Annotated[float | None, "frames a second from the first frame to the last"]
    latency_ms: Annotated[dict[str, float | None], "from the last packet to the decoded frame: p50, p99"]
    decode_ms: Annotated[dict[str, float | None], "time to decode a frame: p50, p99"]
    errors: Annotated[dict[str, int], "messages that could not be used, by cause"]
    replaced: Annotated[int, "frames that a newer one replaced before they were taken"]
    refinements: Annotated[
        dict[str, int] | None,
        "of `--refine`: sectors `taken`, `late`, `lost`, `left_out` (twice, or too many); "
        "frames refined `whole`, in `part`, `base` alone",
    ]
    coding: NotRequired[
        Annotated[
            dict[str, Any],
            "of `subscribe`: what coding left out. `returns_percent` were sent. The rest is what the messages say, "
            "as in `sent` of `info RECORDING`",
        ]
    ]
    udp: Annotated[dict[str, int] | None, "of `--udp`: what was sent"]
    recording: Annotated[dict[str, Any] | None, "of `--record`: its last `file`, why it `stopped`, and `counts`"]


class Bridged(TypedDict):
    """Of `bridge`."""

    streams: Annotated[dict[str, dict[str, Any]], "how each stream was received, as of `subscribe`"]
    clouds: NotRequired[Annotated[int, "clouds handed on"]]
    unwatched: NotRequired[Annotated[int, "clouds that nobody watched"]]
    coded: NotRequired[Annotated[int, "of `bridge ros2`: messages handed on as they are"]]
    url: NotRequired[Annotated[str | None, "of `bridge foxglove`: address for Foxglove"]]
    topics: NotRequired[Annotated[dict[str, str], "of `bridge ros2`: topic of each stream"]]


class Swarmed(TypedDict):
    """Of `swarm`: totals of all vehicles."""

    vehicles: Annotated[int, "number of vehicles"]
    codec: Annotated[str, "name of the codec"]
    frames: Annotated[int, "frames sent"]
    bytes: Annotated[int, "bytes sent"]
    replaced: Annotated[int, "frames that a newer one replaced"]
    no_receiver: Annotated[int, "frames that were not encoded, because nobody received"]
    left_out: Annotated[int, "frames left out to keep the target bitrate"]


class Shown(TypedDict):
    """Of `demo`."""

    source: Annotated[str, "what the vehicle published"]
    page: Annotated[str | None, "address of the page; null without one"]
    picture: Annotated[str | None, "path of the picture of the last frame; null if it was not saved"]
    frames: Annotated[int, "frames received"]
    seconds: Annotated[float, "duration"]
    fps: Annotated[float | None, "frames a second from the first frame to the last"]
    ratio: Annotated[float | None, "packet bytes divided by message bytes"]
    bits_per_point: Annotated[float | None, "bits of the messages divided by the returns"]
    kbps: Annotated[float | None, "bitrate of the messages"]
    raw_kbps: Annotated[float | None, "bitrate of the packets"]
    p50_ms: Annotated[float | None, "median latency"]
    p99_ms: Annotated[float | None, "99th percentile of the latency"]
    encode_ms: Annotated[float | None, "median time to encode a frame"]
    decode_ms: Annotated[float | None, "median time to decode a frame"]
    replaced: Annotated[int, "frames that a newer one replaced, at sender and receiver"]
    errors: Annotated[int, "messages that could not be used"]
    fidelity: Annotated[str, "what the messages promise"]


class Serving(TypedDict):
    """Of `serve`, as soon as it accepts connections, in one line. Nothing is printed at its end."""

    address: Annotated[str, "address of the server"]

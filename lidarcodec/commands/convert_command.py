"""The options of `lidarcodec convert`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from typer import Option

from lidarcodec.commands.arguments import (
    AllowMissed,
    CalibrationFile,
    CodecName,
    Force,
    FrameCount,
    Pairs,
    PosesFile,
    SkipCount,
    Source,
    WithClouds,
)


def convert(
    source: Source,
    out: Annotated[Path, typer.Argument(metavar="OUT", show_default=False, help=".pcap .mcap, or a folder: rosbag2")],
    to: Annotated[
        str | None,
        Option("--to", metavar="FORM", help="pcap, recording, packets (bare ones, .mcap) or rosbag; else as OUT ends."),
    ] = None,
    codec: CodecName = None,
    pairs: Pairs = None,
    with_clouds: WithClouds = False,
    topic: Annotated[
        str | None, Option("--topic", metavar="NAME", help="Of a rosbag's packets; default: /velodyne_packets.")
    ] = None,
    frame_id: Annotated[
        str | None, Option("--frame-id", metavar="NAME", help="Of a rosbag's messages; default: velodyne.")
    ] = None,
    allow_missed: AllowMissed = False,
    force: Force = False,
    frames: FrameCount = None,
    skip: SkipCount = 0,
    calibration: CalibrationFile = None,
    poses: PosesFile = None,
) -> None:
    """Turn a source into a capture, a recording, or a rosbag2 with velodyne_msgs/VelodyneScan: packets as they came."""
    from lidarcodec.commands import convert as command

    command.run(source, out, to, codec, pairs or [], frames, skip, calibration, poses, with_clouds, topic, frame_id,
                force, allow_missed)  # fmt: skip

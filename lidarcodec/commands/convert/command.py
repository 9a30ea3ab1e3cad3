"""The options of `lidarcodec convert`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from typer import Option

from lidarcodec.commands.results.files import Converted
from lidarcodec.commands.running.telling import prints
from lidarcodec.commands.signatures.common import (
    AllowMissed,
    AsJson,
    CalibrationFile,
    CodecName,
    Force,
    FrameCount,
    ModelName,
    Pairs,
    PosesFile,
    SkipCount,
    Source,
    WithClouds,
    of_model,
)


@prints(Converted)
def convert(
    source: Source,
    out: Annotated[
        Path,
        typer.Argument(
            metavar="OUT", show_default=False, help="A file that ends in .pcap or .mcap, or a folder (rosbag2)."
        ),
    ],
    to: Annotated[
        str | None,
        Option(
            "--to",
            metavar="FORM",
            help="Output format: pcap, recording, packets (packets only, .mcap) or rosbag. "
            "Default: by the ending of OUT.",
        ),
    ] = None,
    codec: CodecName = None,
    pairs: Pairs = None,
    with_clouds: WithClouds = False,
    topic: Annotated[
        str | None,
        Option("--topic", metavar="NAME", help="Topic of the packets in a rosbag. Default: /velodyne_packets."),
    ] = None,
    frame_id: Annotated[
        str | None, Option("--frame-id", metavar="NAME", help="frame_id in a rosbag. Default: velodyne.")
    ] = None,
    allow_missed: AllowMissed = False,
    force: Force = False,
    frames: FrameCount = None,
    skip: SkipCount = 0,
    calibration: CalibrationFile = None,
    model: ModelName = None,
    poses: PosesFile = None,
    as_json: AsJson = False,
) -> None:
    """Convert a source to a capture, a recording, or a rosbag2 (velodyne_msgs/VelodyneScan). Packets do not change."""
    from lidarcodec.commands.convert import convert as command

    command.run(of_model(source, model), out, to, codec, pairs or [], frames, skip, calibration, poses, with_clouds,
                topic, frame_id, force, allow_missed, as_json)  # fmt: skip

"""Arguments and options that several commands have."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from typer import Option

MAX_FRAMES = 10**12
"""More than three thousand years of them, and what Python can count to in packets."""

Source = Annotated[str, typer.Argument(metavar="SOURCE", show_default=False, help="A path, udp://HOST:PORT, sim:...")]
CalibrationFile = Annotated[
    Path | None, Option("--calibration", metavar="FILE", help="db.xml or ROS yaml; else found as `info` says.")
]
PosesFile = Annotated[
    Path | None,
    Option("--poses", metavar="FILE", help="Where the sensor was (.npz, TUM or KITTI), sent with each frame."),
]
CodecName = Annotated[str | None, Option("--codec", metavar="NAME", help="Default: pcodec.")]
Pairs = Annotated[
    list[str] | None,
    Option("--set", metavar="KEY=VALUE", help="A field of the stream's settings, else of the codec's. Repeatable."),
]
FrameCount = Annotated[int | None, Option("--frames", min=1, max=MAX_FRAMES, metavar="N", help="Stop after N frames.")]
SkipCount = Annotated[int, Option("--skip", min=0, max=MAX_FRAMES, metavar="N", help="Leave out the first N frames.")]
AllowMissed = Annotated[bool, Option("--allow-missed", help="End with 0 though the target bitrate was missed.")]
Force = Annotated[bool, Option("--force", help="Replace what has the name of an output.")]
WithClouds = Annotated[
    bool, Option("--with-clouds", help="Also keep the decoded points, for viewers such as Foxglove: 18 MB/s.")
]
LearnSteps = Annotated[
    int,
    Option(
        "--learn", min=0, max=1_000_000, metavar="N", help="Train after each frame: N steps; for codecs that learn."
    ),
]
AsJson = Annotated[bool, Option("--json", help="Print JSON.")]
Connect = Annotated[
    list[str] | None,
    Option("--connect", metavar="ENDPOINT", help="Where others listen, such as tcp/192.168.1.5:7447. Repeatable."),
]
Listen = Annotated[
    list[str] | None,
    Option("--listen", metavar="ENDPOINT", help="Where to listen; without any, nothing leaves this machine."),
]
ZenohConfig = Annotated[
    Path | None, Option("--zenoh-config", metavar="FILE", help="A whole Zenoh configuration (JSON5), used as it is.")
]
DatabasePassword = Annotated[
    Path | None, Option("--database-password-file", metavar="FILE", help="The password of --database-url, kept apart.")
]

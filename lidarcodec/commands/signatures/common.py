"""Arguments and options of several commands."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated
from urllib.parse import urlencode

import typer
from typer import Option

MAX_FRAMES = 10**12
"""3,000 years of frames; in packets it still fits Python's `islice`."""


def _countable(frames: int | None) -> int | None:
    """A number of frames, MAX_FRAMES if it is larger: no source has so many."""
    return None if frames is None else min(frames, MAX_FRAMES)


Source = Annotated[
    str, typer.Argument(metavar="SOURCE", show_default=False, help="A path, udp://HOST:PORT, or sim:SCENE.")
]
CalibrationFile = Annotated[
    Path | None,
    Option(
        "--calibration",
        metavar="FILE",
        help="Calibration: db.xml, ROS yaml, Hesai csv, Ouster json. `info` names the default.",
    ),
]
ModelName = Annotated[
    str | None,
    Option(
        "--model",
        metavar="NAME",
        help="Model of the sensor, such as vlp16. Default: detected from the packets. `packets` accepts any packets.",
    ),
]
PosesFile = Annotated[
    Path | None,
    Option("--poses", metavar="FILE", help="Poses of the sensor (.npz, TUM or KITTI). They are sent with each frame."),
]
MountText = Annotated[
    str | None,
    Option(
        "--mount",
        metavar="X,Y,Z,ROLL,PITCH,YAW|FILE",
        help="Where the sensor sits on its vehicle, in metres and degrees, or a file with all sensors (mounts.yaml). "
        "FILE#NAME chooses one.",
    ),
]
PosesOf = Annotated[
    str | None,
    Option(
        "--poses-of",
        metavar="sensor|vehicle",
        help="Whether the file of --poses has poses of the sensor or of the vehicle. Default: sensor. vehicle "
        "needs --mount.",
    ),
]
RecordedVehicle = Annotated[
    str | None,
    Option(
        "--vehicle",
        metavar="NAME",
        help="Name of the vehicle in the recording. Default: that of a recording, else vehicle.",
    ),
]
RecordedSensor = Annotated[
    str | None,
    Option(
        "--sensor",
        metavar="NAME",
        help="Name of the sensor in the recording. Default: that of a recording, else lidar.",
    ),
]
CodecName = Annotated[str | None, Option("--codec", metavar="NAME", help="Name of the codec. Default: pcodec.")]
Pairs = Annotated[
    list[str] | None,
    Option("--set", metavar="KEY=VALUE", help="A stream setting, or a setting of the codec. Repeatable."),
]
FrameCount = Annotated[
    int | None, Option("--frames", min=1, callback=_countable, metavar="N", help="Stop after N frames.")
]
SkipCount = Annotated[int, Option("--skip", min=0, callback=_countable, metavar="N", help="Skip the first N frames.")]
AllowMissed = Annotated[bool, Option("--allow-missed", help="Exit with 0 even if the target bitrate was missed.")]
Force = Annotated[bool, Option("--force", help="Replace outputs that exist.")]
WithClouds = Annotated[
    bool, Option("--with-clouds", help="Also record decoded points for viewers such as Foxglove (18 MB/s).")
]
LearnSteps = Annotated[
    int,
    Option(
        "--learn",
        min=0,
        max=1_000_000,
        metavar="N",
        help="Train N steps after each frame. Only for codecs that can learn.",
    ),
]
AsJson = Annotated[bool, Option("--json", help="Print JSON.")]
Connect = Annotated[
    list[str] | None,
    Option(
        "--connect", metavar="ENDPOINT", help="Connect to this address, for example tcp/192.168.1.5:7447. Repeatable."
    ),
]
Listen = Annotated[
    list[str] | None,
    Option(
        "--listen",
        metavar="ENDPOINT",
        help="Listen on this address. Repeatable. By default, nothing leaves this machine.",
    ),
]
ZenohConfig = Annotated[
    Path | None,
    Option("--zenoh-config", metavar="FILE", help="Zenoh configuration file (JSON5). It is used unchanged."),
]
UntilEnd = Annotated[bool, Option("--until-end", help="Stop when the publisher stops.")]
ReceiverName = Annotated[
    str | None,
    Option("--receiver", metavar="NAME", help="Name in reports to the vehicle. Default: the name in --zenoh-config."),
]
DatabasePassword = Annotated[
    Path | None, Option("--database-password-file", metavar="FILE", help="File with the password for --database-url.")
]


def of_model(source: str, model: str | None) -> str:
    """The source as text, with the option `model`."""
    if model is None:
        return source
    return f"{source}{'&' if '?' in source else '?'}{urlencode({'model': model})}"

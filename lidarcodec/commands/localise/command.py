"""The options of `lidarcodec localise`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from typer import Option

from lidarcodec.commands.results.maps import Located
from lidarcodec.commands.running.run import keep_standard_output
from lidarcodec.commands.running.telling import prints
from lidarcodec.commands.signatures.common import (
    AsJson,
    CalibrationFile,
    Connect,
    Force,
    FrameCount,
    Listen,
    ModelName,
    ReceiverName,
    SkipCount,
    UntilEnd,
    ZenohConfig,
    of_model,
)


@prints(Located)
def localise(
    stream: Annotated[
        str,
        typer.Argument(
            metavar="STREAM",
            show_default=False,
            help="A live stream, VEHICLE/SENSOR, or a source: a path, udp://HOST:PORT, or sim:SCENE.",
        ),
    ],
    town: Annotated[
        str,
        Option(
            "--map",
            metavar="MAP.lcmap|NAME",
            show_default=False,
            help="A map from `map build` or `map compress`; for a live stream also the name of a served map.",
        ),
    ],
    start: Annotated[
        str | None,
        Option(
            "--start",
            metavar="X,Y,YAW",
            help="Rough pose of the sensor in the map, in metres and degrees; 5 m and 20 degrees off is close "
            "enough. Default: the key `odometry` of the stream, or a search over the whole map.",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        Option(
            "-o", "--out", metavar="POSES.txt", help="Write the poses in TUM format, for --poses of other commands."
        ),
    ] = None,
    frames: FrameCount = None,
    skip: SkipCount = 0,
    until_end: UntilEnd = False,
    receiver: ReceiverName = None,
    calibration: CalibrationFile = None,
    model: ModelName = None,
    connect: Connect = None,
    listen: Listen = None,
    zenoh_config: ZenohConfig = None,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Track a sensor in a map: its pose and how certain it is, on the key `pose` of a live stream, or in a file. Ctrl-C
    stops it and prints a summary."""
    from lidarcodec.commands.localise import run

    asked = run.Asked(stream, run.town_of(town), start, out, frames, skip, force)
    key = run.key_of(stream)
    if key is None:
        run.check_source(until_end, receiver, (connect, listen, zenoh_config))
        run.of_source(asked, of_model(stream, model), calibration, as_json)
        return
    run.check_live(calibration, model, skip)
    keep_standard_output()
    run.live(asked, key, receiver, until_end, (connect or [], listen or [], zenoh_config), as_json)

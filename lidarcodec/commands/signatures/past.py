"""The command that gets parts of what a vehicle kept: fetch."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from typer import Option

from lidarcodec.commands.results.files import Fetched
from lidarcodec.commands.running.run import keep_standard_output
from lidarcodec.commands.running.telling import prints
from lidarcodec.commands.signatures.common import AsJson, Connect, Force, Listen, ZenohConfig


@prints(Fetched)
def fetch(
    key: Annotated[str, typer.Argument(metavar="VEHICLE/SENSOR", show_default=False, help="The stream.")],
    begin: Annotated[
        str,
        Option(
            "--from",
            metavar="TIME",
            help="Start of the clip: RFC 3339, seconds before now such as -30, or nanoseconds since 1970.",
        ),
    ],
    end: Annotated[str, Option("--to", metavar="TIME", help="End of the clip, at most an hour later; or `now`.")],
    out: Annotated[Path, Option("--out", "-o", metavar="OUT.mcap", help="The recording to write.")],
    quality: Annotated[str, Option("--quality", metavar="exact", help="Only `exact` can be fetched.")] = "exact",
    patience: Annotated[
        float,
        Option(
            "--patience",
            min=1.0,
            max=1e6,
            metavar="S",
            help="Give up when the vehicle is silent for S s.",
        ),
    ] = 600.0,
    force: Force = False,
    connect: Connect = None,
    listen: Listen = None,
    zenoh_config: ZenohConfig = None,
    as_json: AsJson = False,
) -> None:
    """Fetch a part of what a vehicle kept (`publish --keep`), while it drives. Run it again to continue."""
    from lidarcodec.commands import fetch as command

    keep_standard_output()
    given = (connect or [], listen or [], zenoh_config)
    command.run(key, (begin, end), out, quality, patience, given, force=force, as_json=as_json)

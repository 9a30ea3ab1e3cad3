"""The options of `lidarcodec pipe`."""

from __future__ import annotations

from typing import Annotated

import typer
from typer import Option

from lidarcodec.commands.results.files import Piped
from lidarcodec.commands.running.telling import prints
from lidarcodec.commands.signatures.common import AsJson, CalibrationFile, CodecName, FrameCount, ModelName, Pairs


@prints(Piped)
def pipe(
    source: Annotated[
        str,
        typer.Argument(
            metavar="SOURCE",
            show_default=False,
            help="A source. Default: `-`, for a capture or messages on standard input.",
        ),
    ] = "-",
    form: Annotated[
        str, Option("--to", metavar="FORMAT", help="Output: messages, recording, pcap or points.")
    ] = "messages",
    codec: CodecName = None,
    pairs: Pairs = None,
    frames: FrameCount = None,
    calibration: CalibrationFile = None,
    model: ModelName = None,
    as_json: AsJson = False,
) -> None:
    """Pass frames from standard input to standard output, as they come. The summary goes to standard error."""
    from lidarcodec.commands.pipe import pipe as command

    command.run(source, form, codec, pairs or [], frames, calibration, model, as_json=as_json)

"""`lidarcodec evaluate`: what a stream is good for at its receiver."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from typer import Option

from lidarcodec.commands.arguments import Force

app = typer.Typer(help="Measure what a stream is good for.", no_args_is_help=True, rich_markup_mode=None)


@app.callback()
def _group() -> None:
    """Measure what a stream is good for."""


@app.command()
def localisation(
    sources: Annotated[
        list[str],
        typer.Argument(metavar="SOURCE...", show_default=False, help="Drives; errors are told over them too."),
    ],
    reduction: Annotated[
        list[str] | None,
        Option(
            "--reduction",
            metavar="NAME[,NAME...]",
            help="Reducers, or harris, iss, oracle, oracle-spread, oracle-static.",
        ),
    ] = None,
    codec: Annotated[
        str | None, Option("--codec", metavar="NAME[,NAME...]", help="Default: predictive, to 1 cm.")
    ] = None,
    pairs: Annotated[
        list[str] | None, Option("--set", metavar="KEY=A[,B,C]", help="A setting; several values sweep. Repeatable.")
    ] = None,
    keep_points: Annotated[
        str, Option("--keep-points", metavar="N[,N...]", help="Budgets of a frame; default: 9000.")
    ] = "9000",
    frame_bytes: Annotated[
        int | None, Option("--frame-bytes", min=100, metavar="N", help="Fit each budget to frames of N bytes instead.")
    ] = None,
    maps: Annotated[
        list[str] | None,
        Option("--map", metavar="whole|own", help="Of all returns, or of what was sent. Repeatable; default: whole."),
    ] = None,
    receivers: Annotated[
        list[str] | None,
        Option("--receiver", metavar="decoded|voxel", help="The cloud as it is, or means of 0.5 m cells. Repeatable."),
    ] = None,
    localisers: Annotated[
        list[str] | None,
        Option("--localiser", metavar="plane|vgicp", help="Point-to-plane ICP or VGICP. Repeatable; default: plane."),
    ] = None,
    protocols: Annotated[
        list[str] | None,
        Option("--protocol", metavar="track|starts|near", help="How it is looked for. Repeatable; default: all."),
    ] = None,
    stride: Annotated[int, Option("--stride", min=1, max=100, metavar="N", help="Track every N-th scan.")] = 3,
    reference: Annotated[
        str, Option("--reference", metavar="auto|given|refined", help="auto: exact poses if there are, else refined.")
    ] = "auto",
    sweep: Annotated[
        bool, Option("--sweep", help="Error against bitrate: every codec at the points of its own knob.")
    ] = False,
    seed: Annotated[int, Option("--seed", min=0, max=2**31, metavar="N", help="Of starts, ties and bootstrap.")] = 1,
    frames: Annotated[int | None, Option("--frames", min=2, metavar="N", help="Of each source.")] = None,
    skip: Annotated[int, Option("--skip", min=0, metavar="N", help="Leave out the first N frames.")] = 0,
    calibration: Annotated[Path | None, Option("--calibration", metavar="FILE", help="As everywhere.")] = None,
    poses: Annotated[
        Path | None, Option("--poses", metavar="FILE", help="For --reference given; of one source.")
    ] = None,
    cache: Annotated[
        Path | None, Option("--cache", metavar="DIR", help="Keep what was computed; a second run is quick.")
    ] = None,
    plots: Annotated[Path | None, Option("--plots", metavar="DIR", help="Draw boxes and maps (extra `plot`).")] = None,
    force: Force = False,
    as_json: Annotated[bool, Option("--json", help="Print JSON.")] = False,
) -> None:
    """Find the way through drives by reduced and coded scans alone, and say how far off and how often lost."""
    from lidarcodec.commands import localisation as command

    command.run(
        command.Asked(
            sources, reduction or [], codec, pairs or [], keep_points, frame_bytes, maps or [], receivers or [],
            localisers or [], protocols or [], stride, reference, sweep, seed,
        ),
        frames, skip, calibration, poses, cache, plots, as_json, force,
    )  # fmt: skip

"""`lidarcodec evaluate`: measures how useful a stream is at its receiver."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from typer import Option

from lidarcodec.commands.results.about import Interrupted
from lidarcodec.commands.results.maps import FoundInMap
from lidarcodec.commands.results.measured import Detected, Localised
from lidarcodec.commands.running.telling import prints
from lidarcodec.commands.signatures.common import AsJson, Force

app = typer.Typer(help="Measure how useful decoded streams are.", no_args_is_help=True, rich_markup_mode=None)


@app.callback()
def _group() -> None:
    """Measure how useful decoded streams are."""


@app.command()
@prints(list[Localised | FoundInMap | Interrupted])
def localisation(
    sources: Annotated[
        list[str],
        typer.Argument(
            metavar="SOURCE...",
            show_default=False,
            help="Drives. Errors are given for each drive and for all together.",
        ),
    ],
    reduction: Annotated[
        list[str] | None,
        Option(
            "--reduction",
            metavar="NAME[,NAME...]",
            help="Reducers. For comparison also harris, iss, oracle, oracle-spread, oracle-static.",
        ),
    ] = None,
    codec: Annotated[
        str | None, Option("--codec", metavar="NAME[,NAME...]", help="Default: predictive with max_error_m=0.01.")
    ] = None,
    pairs: Annotated[
        list[str] | None,
        Option(
            "--set", metavar="KEY=A[,B,C]", help="A setting and its values. Repeatable. All combinations are measured."
        ),
    ] = None,
    keep_points: Annotated[
        str, Option("--keep-points", metavar="N[,N...]", help="Returns kept of each frame.")
    ] = "9000",
    frame_bytes: Annotated[
        int | None,
        Option(
            "--frame-bytes",
            min=100,
            metavar="N",
            help="Instead of --keep-points: keep as many returns as fit into N bytes a frame.",
        ),
    ] = None,
    maps: Annotated[
        list[str] | None,
        Option(
            "--map",
            metavar="whole|own|MAP.lcmap",
            help="Build the map from all returns (whole) or from the returns that were sent "
            "(own), or take one of `map build`. Repeatable. Default: whole.",
        ),
    ] = None,
    receivers: Annotated[
        list[str] | None,
        Option(
            "--receiver",
            metavar="decoded|voxel",
            help="Use the decoded cloud as it is, or means of 0.5 m cells. Repeatable.",
        ),
    ] = None,
    localisers: Annotated[
        list[str] | None,
        Option("--localiser", metavar="plane|vgicp", help="Point-to-plane ICP or VGICP. Repeatable. Default: plane."),
    ] = None,
    protocols: Annotated[
        list[str] | None,
        Option("--protocol", metavar="track|starts|near", help="Kind of test. Repeatable. Default: all."),
    ] = None,
    stride: Annotated[int, Option("--stride", min=1, max=100, metavar="N", help="Track every N-th scan.")] = 3,
    reference: Annotated[
        str,
        Option(
            "--reference", metavar="auto|given|refined", help="auto: exact poses if there are any, otherwise refined."
        ),
    ] = "auto",
    sweep: Annotated[
        bool, Option("--sweep", help="Error against bitrate: measure each codec over a range of its quality setting.")
    ] = False,
    seed: Annotated[int, Option("--seed", min=0, max=2**31, metavar="N", help="Seed of all random choices.")] = 1,
    frames: Annotated[int | None, Option("--frames", min=2, metavar="N", help="Use N frames of each source.")] = None,
    skip: Annotated[int, Option("--skip", min=0, metavar="N", help="Skip the first N frames.")] = 0,
    calibration: Annotated[
        Path | None, Option("--calibration", metavar="FILE", help="Calibration: db.xml or ROS yaml.")
    ] = None,
    poses: Annotated[
        Path | None, Option("--poses", metavar="FILE", help="Poses for --reference given. Only for a single source.")
    ] = None,
    cache: Annotated[
        Path | None,
        Option("--cache", metavar="DIR", help="Keep intermediate results here. A second run is then quick."),
    ] = None,
    plots: Annotated[
        Path | None, Option("--plots", metavar="DIR", help="Draw box plots and maps into DIR (extra `plot`).")
    ] = None,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Localise drives with reduced and coded scans only. Print the errors, and how often the position was lost."""
    if any(name.endswith(".lcmap") for name in maps or ()):
        from lidarcodec.commands.evaluate import in_map

        asked = in_map.Asked(sources, maps or [], stride, seed, frames, skip, calibration, poses)
        asked.check(
            {
                "--reduction": reduction, "--codec": codec, "--set": pairs, "--frame-bytes": frame_bytes,
                "--receiver": receivers, "--localiser": localisers, "--protocol": protocols, "--sweep": sweep,
                "--cache": cache, "--plots": plots,
            }
        )  # fmt: skip
        in_map.run(asked, as_json)
        return
    from lidarcodec.commands.evaluate import localisation as command

    command.run(
        command.Asked(
            sources, reduction or [], codec, pairs or [], keep_points, frame_bytes, maps or [], receivers or [],
            localisers or [], protocols or [], stride, reference, sweep, seed,
        ),
        frames, skip, calibration, poses, cache, plots, as_json, force,
    )  # fmt: skip


@app.command()
@prints(list[Detected | Interrupted])
def detection(
    source: Annotated[
        str,
        typer.Argument(metavar="SOURCE", show_default=False, help="A drive. Boxes of simulated drives are known."),
    ],
    codec: Annotated[str | None, Option("--codec", metavar="NAME[,NAME...]", help="Default: pcodec.")] = None,
    pairs: Annotated[
        list[str] | None,
        Option(
            "--set", metavar="KEY=A[,B,C]", help="A setting and its values. Repeatable. All combinations are measured."
        ),
    ] = None,
    recordings: Annotated[
        list[Path] | None,
        Option("--recording", metavar="FILE", help="Also measure the frames of this recording of SOURCE. Repeatable."),
    ] = None,
    labels: Annotated[
        Path | None,
        Option("--labels", metavar="FILE", help="KITTI's labels: a text file of tracking, or tracklet_labels.xml."),
    ] = None,
    camera: Annotated[
        Path | None,
        Option("--camera", metavar="FILE", help="KITTI's calibration of the camera, for labels in a text file."),
    ] = None,
    first_label: Annotated[
        int,
        Option(
            "--first-label", min=-1_000_000, max=1_000_000, metavar="N", help="Number of the label of the first frame."
        ),
    ] = 0,
    frames: Annotated[int | None, Option("--frames", min=1, metavar="N", help="Use N frames.")] = None,
    skip: Annotated[int, Option("--skip", min=0, metavar="N", help="Skip the first N frames.")] = 0,
    calibration: Annotated[
        Path | None, Option("--calibration", metavar="FILE", help="Calibration: db.xml or ROS yaml.")
    ] = None,
    poses: Annotated[
        Path | None, Option("--poses", metavar="FILE", help="Poses, for reductions that use the vehicle's motion.")
    ] = None,
    detector: Annotated[
        str,
        Option(
            "--detector",
            metavar="FILE",
            help="Weights of the detector. `shipped`: those of the package. `none`: only clusters.",
        ),
    ] = "shipped",
    seed: Annotated[int, Option("--seed", min=0, max=2**31, metavar="N", help="Seed of the bootstrap.")] = 1,
    as_json: AsJson = False,
) -> None:
    """Find labelled objects in coded frames, by clusters and by a small network. Print how many are left, and how much
    of them."""
    from lidarcodec.commands.evaluate import detection as command

    command.run(
        source,
        codecs=codec,
        pairs=pairs or [],
        recordings=recordings or [],
        labels=labels,
        camera=camera,
        first_label=first_label,
        frames=frames,
        skip=skip,
        calibration=calibration,
        poses=poses,
        detector=detector,
        seed=seed,
        as_json=as_json,
    )

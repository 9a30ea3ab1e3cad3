"""Commands that work on files: info, encode, decode, verify, annotate, bench and simulate."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from typer import Option

from lidarcodec.commands.results.about import Doctor, Interrupted, MessageInfo, RecordingInfo, SourceInfo
from lidarcodec.commands.results.files import Converted, Labelled, Simulated, Verified
from lidarcodec.commands.results.measured import Benched
from lidarcodec.commands.running.ending import FAILED
from lidarcodec.commands.running.options import known_variables
from lidarcodec.commands.running.telling import prints
from lidarcodec.commands.signatures.common import (
    AllowMissed,
    AsJson,
    CalibrationFile,
    CodecName,
    Force,
    FrameCount,
    LearnSteps,
    ModelName,
    MountText,
    Pairs,
    PosesFile,
    PosesOf,
    RecordedSensor,
    RecordedVehicle,
    SkipCount,
    Source,
    WithClouds,
    of_model,
)
from lidarcodec.commands.signatures.reduction import KeepFraction, KeepPoints, ReductionName, reduced
from lidarcodec.commands.signatures.selecting import FormName, FromTime, Merge, Region, ToTime, Transform, WhichReturns
from lidarcodec.errors import SettingsError


@prints(SourceInfo | RecordingInfo | MessageInfo | Doctor)
def info(
    context: typer.Context,
    source: Annotated[
        str | None, typer.Argument(metavar="SOURCE", show_default=False, help="A source or a recording.")
    ] = None,
    message: Annotated[
        int | None,
        Option("--message", min=0, metavar="N", help="Show message N of a recording, byte by byte."),
    ] = None,
    calibration: CalibrationFile = None,
    model: ModelName = None,
    as_json: AsJson = False,
) -> None:
    """Describe a source or a recording. Without SOURCE: the same as `doctor`."""
    if source is None:
        if message is not None:
            raise SettingsError("--message N needs a recording: lidarcodec info FILE.mcap --message N", "message")
        doctor(context, as_json)
        return
    from lidarcodec.commands.info import command

    command.run(of_model(source, model), message, calibration, as_json)


@prints(Doctor)
def doctor(context: typer.Context, as_json: AsJson = False) -> None:
    """Check this machine: packages, extras, kernel buffers, clock, ports, settings and variables. The exit code is 1 if
    something is bad."""
    from lidarcodec.commands.doctor import command

    if not command.run(known_variables(context.obj), as_json):
        raise typer.Exit(FAILED)


@prints(Converted)
def encode(
    source: Source,
    out: Annotated[Path, typer.Argument(metavar="OUT.mcap", show_default=False)],
    vehicle: RecordedVehicle = None,
    sensor: RecordedSensor = None,
    codec: CodecName = None,
    pairs: Pairs = None,
    reduction: ReductionName = None,
    keep_points: KeepPoints = None,
    keep_fraction: KeepFraction = None,
    frames: FrameCount = None,
    skip: SkipCount = 0,
    begin: FromTime = None,
    end: ToTime = None,
    calibration: CalibrationFile = None,
    model: ModelName = None,
    poses: PosesFile = None,
    mount: MountText = None,
    poses_of: PosesOf = None,
    with_clouds: WithClouds = False,
    learn: LearnSteps = 0,
    allow_missed: AllowMissed = False,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Encode a source into a recording. The short form of `convert`."""
    from lidarcodec.commands import encode as command
    from lidarcodec.commands.selection.frames import Selection
    from lidarcodec.evaluation.coded_recording import Named
    from lidarcodec.sources.mounts import Mounted

    named = Named.of(vehicle, sensor)
    mounted = Mounted.of(mount, poses_of, poses=poses is not None, sensor=sensor)
    pairs = reduced(pairs, reduction, keep_points, keep_fraction)
    selection = Selection(frames, skip, begin, end)
    command.run(
        of_model(source, model),
        out,
        codec=codec,
        pairs=pairs,
        selection=selection,
        calibration=calibration,
        poses=poses,
        clouds=with_clouds,
        learn=learn,
        force=force,
        allow_missed=allow_missed,
        as_json=as_json,
        mounted=mounted,
        named=named,
    )


@prints(Converted)
def decode(
    recording: Annotated[Path, typer.Argument(metavar="IN.mcap", show_default=False)],
    out: Annotated[
        Path,
        typer.Argument(
            metavar="OUT",
            show_default=False,
            help="A file that ends in .pcap .mcap .npz .ply .pcd .las .laz .csv or .e57, or a folder (KITTI).",
        ),
    ],
    form: FormName = None,
    frames: FrameCount = None,
    skip: SkipCount = 0,
    begin: FromTime = None,
    end: ToTime = None,
    region: Region = None,
    transform: Transform = None,
    merge: Merge = False,
    returns: WhichReturns = "first",
    poses: PosesFile = None,
    mount: MountText = None,
    poses_of: PosesOf = None,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Decode a recording into packets, images or points. The short form of `convert`."""
    from lidarcodec.commands import decode as command
    from lidarcodec.commands.selection.frames import Selection
    from lidarcodec.commands.selection.points import Placing
    from lidarcodec.sources.mounts import Mounted

    selection, placing = (
        Selection(frames, skip, begin, end),
        Placing.of(region, transform, merge=merge, returns=returns),
    )
    mounted = Mounted.of(mount, poses_of, poses=poses is not None, sensor=None)
    command.run(recording, out, form, selection, placing, poses, mounted, force, as_json)


@prints(Verified)
def verify(
    recording: Annotated[Path, typer.Argument(metavar="RECORDING", show_default=False)],
    source: Source,
    calibration: CalibrationFile = None,
    model: ModelName = None,
    allow_part: Annotated[
        bool,
        Option("--allow-part", help="Accept a recording with only a part of the source. The report names the part."),
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Compare a recording with its source. The exit code is 1 if an error is larger than allowed, or if packets are
    missing."""
    from lidarcodec.commands import verify as command

    if not command.run(recording, of_model(source, model), calibration, as_json, allow_part):
        raise typer.Exit(FAILED)


@prints(Labelled)
def annotate(
    source: Source,
    out: Annotated[
        Path, Option("--out", metavar="DIR", show_default=False, help="Output folder. An unfinished run is continued.")
    ],
    poses: PosesFile = None,
    refine: Annotated[
        bool | None,
        Option(
            "--refine/--no-refine",
            show_default=False,
            help="Align the poses with the map. Default: only for poses from a file.",
        ),
    ] = None,
    odometry: Annotated[
        str | None,
        Option("--odometry", metavar="NAME", help="Find the poses by odometry: auto, small_gicp or kiss-icp."),
    ] = None,
    ground: Annotated[
        str, Option("--ground", metavar="NAME", help="How ground is found: ransac or patchwork.")
    ] = "ransac",
    share: Annotated[float, Option("--share", help="Share of all returns to label high.")] = 1 / 12,
    every: Annotated[int, Option("--every", metavar="N", help="Build the map from every N-th scan.")] = 5,
    travel: Annotated[
        float, Option("--travel", metavar="M", help="Minimum distance between two used poses, in metres.")
    ] = 0.5,
    label_every: Annotated[int, Option("--label-every", metavar="N", help="Label every N-th scan.")] = 1,
    workers: Annotated[int, Option("--workers", min=1, metavar="N", help="Number of processes.")] = 1,
    frames: FrameCount = None,
    skip: SkipCount = 0,
    calibration: CalibrationFile = None,
    model: ModelName = None,
    as_json: AsJson = False,
) -> None:
    """Label each return of a drive as high, low or ground. High: its place was seen from many poses. Continues an
    unfinished run."""
    from lidarcodec.commands import annotate as command

    command.run(of_model(source, model), out, frames, skip, calibration, poses, workers, as_json, refine=refine,
                odometry=odometry, ground=ground, share=share, every=every, travel_m=travel,
                label_every=label_every)  # fmt: skip


@prints(list[Benched | Interrupted])
def bench(
    source: Source,
    codec: Annotated[
        str | None, Option("--codec", metavar="NAME[,NAME...]", help="Codecs to measure. Default: pcodec.")
    ] = None,
    pairs: Annotated[
        list[str] | None,
        Option(
            "--set", metavar="KEY=A[,B,C]", help="A setting and its values. Repeatable. All combinations are measured."
        ),
    ] = None,
    reduction: ReductionName = None,
    keep_points: KeepPoints = None,
    keep_fraction: KeepFraction = None,
    frames: FrameCount = None,
    skip: SkipCount = 0,
    calibration: CalibrationFile = None,
    model: ModelName = None,
    poses: PosesFile = None,
    plot: Annotated[
        Path | None, Option("--plot", metavar="FILE", help="Also draw the results into FILE (extra `plot`).")
    ] = None,
    metrics: Annotated[
        str,
        Option(
            "--metrics",
            metavar="usual|all",
            help="`all` adds errors by range, Chamfer distance, D1 and D2. It is slower.",
        ),
    ] = "usual",
    curve: Annotated[
        bool,
        Option(
            "--curve",
            help="Measure each codec over a range of its quality setting. With --metrics all: over target bitrates.",
        ),
    ] = False,
    peers: Annotated[
        bool,
        Option(
            "--peers",
            help="Also measure compressors of other projects (extra `peers`). For one only: --codec peer:NAME.",
        ),
    ] = False,
    learn: LearnSteps = 0,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Measure codecs on a source: bits, errors and times. Every message is decoded and compared."""
    from lidarcodec.commands.bench import command

    pairs = reduced(pairs, reduction, keep_points, keep_fraction)
    command.run(
        of_model(source, model),
        codecs=codec,
        pairs=pairs,
        frames=frames,
        skip=skip,
        calibration=calibration,
        poses=poses,
        plot=plot,
        as_json=as_json,
        metrics=metrics,
        as_curve=curve,
        peers=peers,
        learn=learn,
        force=force,
    )


@prints(Simulated)
def simulate(
    source: Annotated[str, typer.Argument(metavar="sim:SCENE", show_default=False)],
    out: Annotated[Path, typer.Argument(metavar="OUT.pcap", show_default=False)],
    frames: FrameCount = None,
    skip: SkipCount = 0,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Write a simulated drive as a capture: sim:city, road, street, bend, motorway, garage, room; ?sensor=os1-128."""
    from lidarcodec.commands import simulate as command

    command.run(source, out, frames, skip, force, as_json)

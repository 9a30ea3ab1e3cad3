"""The command line: one subcommand is one short function, and what it does is in `lidarcodec.commands`.

Nothing heavy is imported here, so that `lidarcodec --help` answers at once. Exit codes: 0 done, 1 failed at work, 2
wrong usage, 130 or 143 interrupted by SIGINT or SIGTERM (live commands end with 0 then). An error is one line on
stderr; a traceback only with `--debug`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, NoReturn

import typer
from typer import Option

from lidarcodec.commands import bridge, evaluate, fleet, running, token, train
from lidarcodec.commands.arguments import (
    MAX_FRAMES,
    AllowMissed,
    AsJson,
    CalibrationFile,
    CodecName,
    Connect,
    Force,
    FrameCount,
    LearnSteps,
    Listen,
    Pairs,
    PosesFile,
    SkipCount,
    Source,
    WithClouds,
    ZenohConfig,
)
from lidarcodec.commands.convert_command import convert
from lidarcodec.commands.ending import FAILED, WRONG_USAGE
from lidarcodec.commands.join import join
from lidarcodec.commands.reduction import KeepFraction, KeepPoints, ReductionName, reduced
from lidarcodec.commands.running import keep_standard_output
from lidarcodec.errors import SettingsError

app = typer.Typer(
    help="Velodyne HDL-64 packets in, the same packets out, a fraction of the bits between.",
    add_completion=False,
    invoke_without_command=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog="A SOURCE is a path (.pcap .pcapng .mcap .pcap.zst .pcap.xz, a KITTI folder, a rosbag), udp://HOST:PORT, or "
    "sim:city|road|street|bend|motorway[?seed=1&frames=100]. Every option can also be set by an environment variable.",
)


app.add_typer(token.app, name="token")
app.add_typer(evaluate.app, name="evaluate")
app.add_typer(train.app, name="train")
app.add_typer(bridge.app, name="bridge")


@app.callback()
def _common(
    context: typer.Context,
    debug: Annotated[bool, Option("--debug", help="Show the traceback of an error.")] = False,
    version: Annotated[bool, Option("--version", help="Print the version and end.", is_eager=True)] = False,
) -> None:
    del debug  # main() looks for it, wherever it stands
    if version:
        from lidarcodec import __version__

        print(__version__)
        raise typer.Exit
    if context.invoked_subcommand is None:
        typer.echo(context.get_help(), err=True)
        raise typer.Exit(WRONG_USAGE)


@app.command()
def info(
    source: Annotated[str | None, typer.Argument(metavar="[SOURCE]", show_default=False)] = None,
    message: Annotated[
        int | None, Option("--message", min=0, max=MAX_FRAMES, metavar="N", help="Dump message N of a recording.")
    ] = None,
    calibration: CalibrationFile = None,
    as_json: AsJson = False,
) -> None:
    """Say what a source or a recording holds; without SOURCE: versions, extras, ports, clock and settings."""
    from lidarcodec.commands import info as command

    command.run(source, message, calibration, as_json)


@app.command()
def encode(
    source: Source,
    out: Annotated[Path, typer.Argument(metavar="OUT.mcap", show_default=False)],
    codec: CodecName = None,
    pairs: Pairs = None,
    reduction: ReductionName = None,
    keep_points: KeepPoints = None,
    keep_fraction: KeepFraction = None,
    frames: FrameCount = None,
    skip: SkipCount = 0,
    calibration: CalibrationFile = None,
    poses: PosesFile = None,
    with_clouds: WithClouds = False,
    learn: LearnSteps = 0,
    allow_missed: AllowMissed = False,
    force: Force = False,
) -> None:
    """Encode a source into a recording."""
    from lidarcodec.commands import encode as command

    pairs = reduced(pairs, reduction, keep_points, keep_fraction)
    command.run(source, out, codec, pairs, frames, skip, calibration, poses, with_clouds, learn, force, allow_missed)


@app.command()
def decode(
    recording: Annotated[Path, typer.Argument(metavar="IN.mcap", show_default=False)],
    out: Annotated[Path, typer.Argument(metavar="OUT", show_default=False, help=".pcap .npz .ply .las, or a folder")],
    frames: FrameCount = None,
    skip: SkipCount = 0,
    force: Force = False,
) -> None:
    """Decode a recording into packets (.pcap), images (.npz), points (.ply .las) or a folder of KITTI .bin files."""
    from lidarcodec.commands import decode as command

    command.run(recording, out, frames, skip, force)


app.command()(convert)
app.command()(join)


@app.command()
def verify(
    recording: Annotated[Path, typer.Argument(metavar="RECORDING", show_default=False)],
    source: Source,
    calibration: CalibrationFile = None,
    allow_part: Annotated[
        bool, Option("--allow-part", help="The recording may hold only a part of its source; say which.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Compare a recording with its source; exit code 1 if it breaks what its settings promise, or does not hold all."""
    from lidarcodec.commands import verify as command

    if not command.run(recording, source, calibration, as_json, allow_part):
        raise typer.Exit(FAILED)


@app.command()
def annotate(
    source: Source,
    out: Annotated[Path, Option("--out", metavar="DIR", show_default=False, help="Folder; taken up if begun.")],
    poses: PosesFile = None,
    refine: Annotated[
        bool | None,
        Option("--refine/--no-refine", show_default=False, help="Align poses with the map; of files: yes."),
    ] = None,
    odometry: Annotated[str | None, Option("--odometry", metavar="NAME", help="auto, small_gicp or kiss-icp.")] = None,
    ground: Annotated[str, Option("--ground", metavar="NAME", help="ransac or patchwork.")] = "ransac",
    share: Annotated[float, Option("--share", help="Of all returns, those to be labelled high.")] = 1 / 12,
    every: Annotated[int, Option("--every", metavar="N", help="The map is of every N-th scan.")] = 5,
    travel: Annotated[float, Option("--travel", metavar="M", help="Least way between poses that count.")] = 0.5,
    label_every: Annotated[int, Option("--label-every", metavar="N", help="Label every N-th scan.")] = 1,
    workers: Annotated[int, Option("--workers", min=1, metavar="N", help="Processes to work in.")] = 1,
    frames: FrameCount = None,
    skip: SkipCount = 0,
    calibration: CalibrationFile = None,
    as_json: AsJson = False,
) -> None:
    """Label each return of a drive by how many places saw its spot: high, low or ground. Goes on where it stopped."""
    from lidarcodec.commands import annotate as command

    command.run(source, out, frames, skip, calibration, poses, workers, as_json, refine=refine, odometry=odometry,
                ground=ground, share=share, every=every, travel_m=travel, label_every=label_every)  # fmt: skip


@app.command()
def bench(
    source: Source,
    codec: Annotated[str | None, Option("--codec", metavar="NAME[,NAME...]", help="Default: pcodec.")] = None,
    pairs: Annotated[
        list[str] | None,
        Option("--set", metavar="KEY=A[,B,C]", help="A setting; several values sweep. Repeatable: all combinations."),
    ] = None,
    reduction: ReductionName = None,
    keep_points: KeepPoints = None,
    keep_fraction: KeepFraction = None,
    frames: FrameCount = None,
    skip: SkipCount = 0,
    calibration: CalibrationFile = None,
    poses: PosesFile = None,
    plot: Annotated[Path | None, Option("--plot", metavar="FILE", help="Also draw the results (extra `plot`).")] = None,
    metrics: Annotated[
        str, Option("--metrics", metavar="usual|all", help="`all`: also errors by range, Chamfer, D1, D2 (slower).")
    ] = "usual",
    curve: Annotated[
        bool,
        Option("--curve", help="Every codec over its own knob; with --metrics all over target bitrates."),
    ] = False,
    peers: Annotated[
        bool, Option("--peers", help="Also other people's coders (extra `peers`); --codec peer:NAME takes one.")
    ] = False,
    learn: LearnSteps = 0,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Measure codecs on a source: bits by plane, errors, times. Every message is decoded and compared."""
    from lidarcodec.commands import bench as command

    pairs = reduced(pairs, reduction, keep_points, keep_fraction)
    command.run(
        source, codec, pairs, frames, skip, calibration, poses, plot, as_json, metrics, curve, peers, learn, force
    )


@app.command()
def simulate(
    source: Annotated[str, typer.Argument(metavar="sim:SCENE", show_default=False)],
    out: Annotated[Path, typer.Argument(metavar="OUT.pcap", show_default=False)],
    frames: FrameCount = None,
    skip: SkipCount = 0,
    force: Force = False,
) -> None:
    """Write a simulated drive as a capture: sim:city, road, street, bend or motorway, with ?seed=1&frames=100."""
    from lidarcodec.commands import simulate as command

    command.run(source, out, frames, skip, force)


@app.command()
def publish(
    source: Annotated[
        str | None, typer.Argument(metavar="[SOURCE]", show_default=False, help="A path, udp://HOST:PORT, sim:...")
    ] = None,
    vehicle: Annotated[
        str | None, Option("--vehicle", metavar="NAME", help="Default: the name in --zenoh-config, else vehicle.")
    ] = None,
    sensor: Annotated[str | None, Option("--sensor", metavar="NAME", help="Default: lidar.")] = None,
    link: Annotated[
        str | None,
        Option(
            "--link",
            metavar="1mbit|2mbit|5mbit|lan",
            help="Purpose, codec and target bitrate for such a link; what is given beside it wins.",
        ),
    ] = None,
    codec: CodecName = None,
    pairs: Pairs = None,
    reduction: ReductionName = None,
    keep_points: KeepPoints = None,
    keep_fraction: KeepFraction = None,
    rate: Annotated[
        str | None,
        Option("--rate", metavar="HZ|max", help="Frames a second of a recorded source (default 10), or every one."),
    ] = None,
    connect: Connect = None,
    listen: Listen = None,
    zenoh_config: ZenohConfig = None,
    record: Annotated[Path | None, Option("--record", metavar="DIR", help="Keep everything, whatever is sent.")] = None,
    record_as: Annotated[
        str | None, Option("--record-as", metavar="packets|lossless", help="In which form; default: packets.")
    ] = None,
    record_gb: Annotated[
        float | None,
        Option("--record-gb", min=0.001, max=1e6, metavar="N", help="Size of DIR (8); the oldest files go first."),
    ] = None,
    calibration: CalibrationFile = None,
    poses: Annotated[
        Path | None,
        Option("--poses", metavar="FILE|source", help="As for encode; source: those it has itself."),
    ] = None,
    original: Annotated[
        bool, Option("--original", help="Send the originals, too, to programs on this machine that compare.")
    ] = False,
    config: Annotated[
        Path | None, Option("--config", metavar="FILE", help="Several sensors, with all of this, from a YAML file.")
    ] = None,
    health_file: Annotated[
        Path | None, Option("--health-file", metavar="FILE", help="Say there once a second how it goes, for `health`.")
    ] = None,
    weights_dir: Annotated[
        Path | None, Option("--weights-dir", metavar="DIR", help="Own weights of `riddle`, which settings may name.")
    ] = None,
) -> None:
    """Publish a source over Zenoh, newest frame first, until it ends or a signal comes."""
    from lidarcodec.commands import publish as command

    keep_standard_output()
    if config is not None:
        from lidarcodec.commands import publish_config

        command.check_alone(
            {
                "SOURCE": source, "--sensor": sensor, "--link": link, "--codec": codec, "--set": pairs,
                "--reduction": reduction, "--keep-points": keep_points, "--keep-fraction": keep_fraction,
                "--rate": rate, "--record": record, "--record-as": record_as, "--record-gb": record_gb,
                "--calibration": calibration, "--poses": poses, "--original": original,
            }
        )  # fmt: skip
        publish_config.run(config, vehicle, (connect or [], listen or [], zenoh_config), health_file, weights_dir)
        return
    if source is None:
        raise SettingsError("publish what? give a SOURCE, or --config FILE", "source")
    if record is None and (record_as is not None or record_gb is not None):
        raise SettingsError("--record-as and --record-gb say how it is kept: say where with --record DIR", "record")
    command.run(
        source, vehicle, sensor or "lidar", codec, reduced(pairs, reduction, keep_points, keep_fraction), rate,
        (connect or [], listen or [], zenoh_config),
        record, record_as or "packets", 8.0 if record_gb is None else record_gb, calibration, poses,
        health_file, original, weights_dir, link,
    )  # fmt: skip


@app.command()
def subscribe(
    key: Annotated[
        str, typer.Argument(metavar="[KEY]", help="lidarcodec/v1/VEHICLE/SENSOR, or VEHICLE/SENSOR.")
    ] = "lidarcodec/v1/vehicle/lidar",
    udp: Annotated[
        str | None, Option("--udp", metavar="HOST:PORT", help="Send the decoded packets on, as the sensor would.")
    ] = None,
    record: Annotated[Path | None, Option("--record", metavar="DIR", help="Keep the messages as recordings.")] = None,
    with_clouds: WithClouds = False,
    frames: FrameCount = None,
    until_end: Annotated[bool, Option("--until-end", help="Stop when the publisher has gone.")] = False,
    receiver: Annotated[
        str | None,
        Option("--receiver", metavar="NAME", help="Name under which it reports. Default: that in --zenoh-config."),
    ] = None,
    connect: Connect = None,
    listen: Listen = None,
    zenoh_config: ZenohConfig = None,
    as_json: AsJson = False,
) -> None:
    """Receive and decode a stream until a signal comes, and say how it went."""
    from lidarcodec.commands import subscribe as command

    if with_clouds and record is None:
        raise SettingsError("--with-clouds goes into recordings: say where they are kept with --record DIR", "record")
    keep_standard_output()
    given = (connect or [], listen or [], zenoh_config)
    command.run(key, udp, record, frames, until_end, receiver, given, as_json, with_clouds)


app.command()(fleet.swarm)
app.command()(fleet.certs)
app.command()(fleet.serve)
app.command()(fleet.health)


@app.command()
def demo(
    seconds: Annotated[
        float | None, Option("--seconds", min=1, metavar="N", help="How long: on a terminal until Ctrl-C, else 20.")
    ] = None,
    source: Annotated[str, Option("--source", metavar="SOURCE", help="What the vehicle sees.")] = "sim:city",
    codec: CodecName = None,
    pairs: Pairs = None,
    calibration: CalibrationFile = None,
    no_browser: Annotated[bool, Option("--no-browser", help="Only say where the page is.")] = False,
    port: Annotated[
        int | None, Option("--port", min=1, max=65535, metavar="P", help="Of the page: 8080, or one that is free.")
    ] = None,
) -> None:
    """Drive through a simulated town, live on a page in the browser: a vehicle, a server, and a summary at the end."""
    from lidarcodec.commands import demo as command

    keep_standard_output()
    command.run(seconds, source, codec, pairs or [], calibration, port=port, browser=not no_browser)


def run(arguments: list[str]) -> int:
    """Run one command; its exit code."""
    return running.run(app, arguments)


def main() -> NoReturn:
    """The process: run the command of the command line and end."""
    running.main(app)


if __name__ == "__main__":
    main()

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

from lidarcodec.commands import bridge, fleet, token
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
from lidarcodec.commands.convert.command import convert
from lidarcodec.commands.evaluate import command as evaluate
from lidarcodec.commands.join.command import join
from lidarcodec.commands.reduction import KeepFraction, KeepPoints, ReductionName, reduced
from lidarcodec.commands.running import run as running
from lidarcodec.commands.running.ending import FAILED, WRONG_USAGE
from lidarcodec.commands.running.run import keep_standard_output
from lidarcodec.commands.train import command as train
from lidarcodec.errors import SettingsError

app = typer.Typer(
    help="Compress LiDAR packets (Velodyne HDL-64E), send or store them, and get the same packets back.",
    add_completion=False,
    invoke_without_command=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog="A SOURCE is a path (.pcap .pcapng .mcap .pcap.zst .pcap.xz, a KITTI folder, a rosbag), "
    "udp://HOST:PORT, or sim:city|road|street|bend|motorway[?seed=1&frames=100]. Every option can also be "
    "set by an environment variable.",
)


app.add_typer(token.app, name="token")
app.add_typer(evaluate.app, name="evaluate")
app.add_typer(train.app, name="train")
app.add_typer(bridge.app, name="bridge")


@app.callback()
def _common(
    context: typer.Context,
    debug: Annotated[bool, Option("--debug", help="Show the traceback of an error.")] = False,
    version: Annotated[bool, Option("--version", help="Print the version and exit.", is_eager=True)] = False,
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
    source: Annotated[
        str | None, typer.Argument(metavar="[SOURCE]", show_default=False, help="A source or a recording.")
    ] = None,
    message: Annotated[
        int | None,
        Option("--message", min=0, max=MAX_FRAMES, metavar="N", help="Show message N of a recording, byte by byte."),
    ] = None,
    calibration: CalibrationFile = None,
    as_json: AsJson = False,
) -> None:
    """Describe a source or a recording. Without SOURCE: show versions, extras, ports, clock and settings."""
    from lidarcodec.commands.info import command

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
    out: Annotated[
        Path,
        typer.Argument(
            metavar="OUT", show_default=False, help="A file that ends in .pcap .npz .ply or .las, or a folder."
        ),
    ],
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
        bool,
        Option(
            "--allow-part", help="Accept a recording that holds only a part of the source. The report names the part."
        ),
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Compare a recording with its source. The exit code is 1 if an error is larger than allowed, or if packets are
    missing."""
    from lidarcodec.commands import verify as command

    if not command.run(recording, source, calibration, as_json, allow_part):
        raise typer.Exit(FAILED)


@app.command()
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
    share: Annotated[float, Option("--share", help="Share of all returns that are labelled high.")] = 1 / 12,
    every: Annotated[int, Option("--every", metavar="N", help="Build the map from every N-th scan.")] = 5,
    travel: Annotated[
        float, Option("--travel", metavar="M", help="Least distance between poses that count, in metres.")
    ] = 0.5,
    label_every: Annotated[int, Option("--label-every", metavar="N", help="Label every N-th scan.")] = 1,
    workers: Annotated[int, Option("--workers", min=1, metavar="N", help="Number of processes.")] = 1,
    frames: FrameCount = None,
    skip: SkipCount = 0,
    calibration: CalibrationFile = None,
    as_json: AsJson = False,
) -> None:
    """Label each return of a drive as high, low or ground. High: it was seen from many places. Continues an
    unfinished run."""
    from lidarcodec.commands import annotate as command

    command.run(source, out, frames, skip, calibration, poses, workers, as_json, refine=refine, odometry=odometry,
                ground=ground, share=share, every=every, travel_m=travel, label_every=label_every)  # fmt: skip


@app.command()
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
        str | None,
        typer.Argument(metavar="[SOURCE]", show_default=False, help="A path, udp://HOST:PORT, or sim:SCENE."),
    ] = None,
    vehicle: Annotated[
        str | None,
        Option(
            "--vehicle",
            metavar="NAME",
            help="Name of the vehicle. Default: the name in --zenoh-config, otherwise `vehicle`.",
        ),
    ] = None,
    sensor: Annotated[
        str | None, Option("--sensor", metavar="NAME", help="Name of the sensor. Default: lidar.")
    ] = None,
    link: Annotated[
        str | None,
        Option(
            "--link",
            metavar="1mbit|2mbit|5mbit|lan",
            help="Choose purpose, codec and target bitrate for this link. Other options take precedence.",
        ),
    ] = None,
    codec: CodecName = None,
    pairs: Pairs = None,
    reduction: ReductionName = None,
    keep_points: KeepPoints = None,
    keep_fraction: KeepFraction = None,
    rate: Annotated[
        str | None,
        Option(
            "--rate",
            metavar="HZ|max",
            help="Play a recorded source at HZ frames a second (default: 10). max: do not skip any frame.",
        ),
    ] = None,
    connect: Connect = None,
    listen: Listen = None,
    zenoh_config: ZenohConfig = None,
    record: Annotated[
        Path | None, Option("--record", metavar="DIR", help="Also record the whole stream into DIR, whatever is sent.")
    ] = None,
    record_as: Annotated[
        str | None, Option("--record-as", metavar="packets|lossless", help="Form of that recording. Default: packets.")
    ] = None,
    record_gb: Annotated[
        float | None,
        Option(
            "--record-gb",
            min=0.001,
            max=1e6,
            metavar="N",
            help="Size limit of DIR in GB (default: 8). The oldest files are removed first.",
        ),
    ] = None,
    calibration: CalibrationFile = None,
    poses: Annotated[
        Path | None,
        Option(
            "--poses",
            metavar="FILE|source",
            help="Poses to send: a file (.npz, TUM or KITTI), or `source` for those of the source itself.",
        ),
    ] = None,
    original: Annotated[
        bool, Option("--original", help="Also send uncompressed frames to local viewers that use Compare.")
    ] = False,
    config: Annotated[
        Path | None,
        Option(
            "--config",
            metavar="FILE",
            help="Publish several sensors as described in a YAML file. It replaces most other options.",
        ),
    ] = None,
    health_file: Annotated[
        Path | None,
        Option(
            "--health-file", metavar="FILE", help="Write the state to FILE once a second. `lidarcodec health` reads it."
        ),
    ] = None,
    weights_dir: Annotated[
        Path | None,
        Option(
            "--weights-dir",
            metavar="DIR",
            help="Folder with your own weights for `riddle`. The setting `weights` can name them.",
        ),
    ] = None,
) -> None:
    """Publish a source over Zenoh. The newest frame is sent first. Stops when the source ends, or with Ctrl-C."""
    from lidarcodec.commands.publish import command

    keep_standard_output()
    if config is not None:
        from lidarcodec.commands.publish import config as publish_config

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
        raise SettingsError("nothing to publish: give a SOURCE, or --config FILE", "source")
    if record is None and (record_as is not None or record_gb is not None):
        raise SettingsError("--record-as and --record-gb need --record DIR", "record")
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
        str | None,
        Option("--udp", metavar="HOST:PORT", help="Send the decoded packets to this address, as the sensor would."),
    ] = None,
    record: Annotated[
        Path | None, Option("--record", metavar="DIR", help="Record the received messages into DIR.")
    ] = None,
    with_clouds: WithClouds = False,
    frames: FrameCount = None,
    until_end: Annotated[bool, Option("--until-end", help="Stop when the publisher stops.")] = False,
    receiver: Annotated[
        str | None,
        Option(
            "--receiver", metavar="NAME", help="Name in reports to the vehicle. Default: the name in --zenoh-config."
        ),
    ] = None,
    connect: Connect = None,
    listen: Listen = None,
    zenoh_config: ZenohConfig = None,
    as_json: AsJson = False,
) -> None:
    """Receive and decode a stream. Ctrl-C stops it and prints a summary."""
    from lidarcodec.commands import subscribe as command

    if with_clouds and record is None:
        raise SettingsError("--with-clouds needs --record DIR: points are kept in recordings", "record")
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
        float | None,
        Option("--seconds", min=1, metavar="N", help="Duration. Default: 20 s; on a terminal until Ctrl-C."),
    ] = None,
    source: Annotated[str, Option("--source", metavar="SOURCE", help="What the vehicle publishes.")] = "sim:city",
    codec: CodecName = None,
    pairs: Pairs = None,
    calibration: CalibrationFile = None,
    no_browser: Annotated[
        bool, Option("--no-browser", help="Print the address of the page, but do not open a browser.")
    ] = False,
    port: Annotated[
        int | None,
        Option(
            "--port",
            min=1,
            max=65535,
            metavar="P",
            help="Port of the page. Default: 8080, or a free port if it is taken.",
        ),
    ] = None,
) -> None:
    """Show a simulated drive live in the browser. Runs a vehicle and a server, and prints a summary at the end."""
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

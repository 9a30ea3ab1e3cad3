"""The command line: one subcommand is one short function, and what it does is in `lidarcodec.commands`.

Nothing heavy is imported here, so that `lidarcodec --help` answers at once. Exit codes: 0 done (also when stopped by
SIGINT or SIGTERM), 1 failed at work, 2 wrong usage. An error is one line on stderr; a traceback only with `--debug`.
"""

from __future__ import annotations

import contextlib
import errno
import logging
import os
import sys
import traceback
from pathlib import Path
from typing import Annotated, NoReturn

import typer

from lidarcodec.commands import evaluate, token
from lidarcodec.commands.options import option as _option
from lidarcodec.commands.reduction import KeepFraction, KeepPoints, ReductionName, reduced
from lidarcodec.commands.stopping import Interrupter
from lidarcodec.errors import LidarCodecError, SettingsError, UnknownNameError

DONE, FAILED, WRONG_USAGE = 0, 1, 2
MAX_FRAMES = 10**12
"""More than three thousand years of them, and what Python can count to in packets."""
_STOPPED = 130
"""What typer makes of a KeyboardInterrupt."""

app = typer.Typer(
    help="Velodyne HDL-64 packets in, the same packets out, a fraction of the bits between.",
    add_completion=False,
    invoke_without_command=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog="A SOURCE is a path (.pcap .pcapng .mcap .pcap.zst .pcap.xz, a KITTI folder), udp://HOST:PORT, or "
    "sim:city|road|street[?seed=1&frames=100]. Every option can also be set by an environment variable.",
)


app.add_typer(token.app, name="token")
app.add_typer(evaluate.app, name="evaluate")

Source = Annotated[str, typer.Argument(metavar="SOURCE", show_default=False, help="A path, udp://HOST:PORT, sim:...")]
CalibrationFile = Annotated[
    Path | None, _option("--calibration", metavar="FILE", help="db.xml or ROS yaml; else found as `info` says.")
]
PosesFile = Annotated[
    Path | None,
    _option("--poses", metavar="FILE", help="Where the sensor was (.npz, TUM or KITTI), sent with each frame."),
]
CodecName = Annotated[str | None, _option("--codec", metavar="NAME", help="Default: pcodec.")]
Pairs = Annotated[
    list[str] | None,
    _option("--set", metavar="KEY=VALUE", help="A field of the stream's settings, else of the codec's. Repeatable."),
]
FrameCount = Annotated[int | None, _option("--frames", min=1, max=MAX_FRAMES, metavar="N", help="Stop after N frames.")]
SkipCount = Annotated[int, _option("--skip", min=0, max=MAX_FRAMES, metavar="N", help="Leave out the first N frames.")]
AsJson = Annotated[bool, _option("--json", help="Print JSON.")]


@app.callback()
def _common(
    context: typer.Context,
    debug: Annotated[bool, _option("--debug", help="Show the traceback of an error.")] = False,
    version: Annotated[bool, typer.Option("--version", help="Print the version and end.", is_eager=True)] = False,
) -> None:
    del debug  # main() looks for it, wherever it stands
    if version:
        from lidarcodec import __version__

        typer.echo(__version__)
        raise typer.Exit
    if context.invoked_subcommand is None:
        typer.echo(context.get_help(), err=True)
        raise typer.Exit(WRONG_USAGE)


@app.command()
def info(
    source: Annotated[str | None, typer.Argument(metavar="[SOURCE]", show_default=False)] = None,
    message: Annotated[
        int | None, _option("--message", min=0, metavar="N", help="Dump message N of a recording.")
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
) -> None:
    """Encode a source into a recording."""
    from lidarcodec.commands import encode as command

    pairs = reduced(pairs, reduction, keep_points, keep_fraction)
    command.run(source, out, codec, pairs, frames, skip, calibration, poses)


@app.command()
def decode(
    recording: Annotated[Path, typer.Argument(metavar="IN.mcap", show_default=False)],
    out: Annotated[Path, typer.Argument(metavar="OUT", show_default=False, help=".pcap .npz .ply .las, or a folder")],
    frames: FrameCount = None,
    skip: SkipCount = 0,
) -> None:
    """Decode a recording into packets (.pcap), images (.npz), points (.ply .las) or a folder of KITTI .bin files."""
    from lidarcodec.commands import decode as command

    command.run(recording, out, frames, skip)


@app.command()
def verify(
    recording: Annotated[Path, typer.Argument(metavar="RECORDING", show_default=False)],
    source: Source,
    calibration: CalibrationFile = None,
    as_json: AsJson = False,
) -> None:
    """Compare a recording with the source it was made from; exit code 1 if it breaks what its settings promise."""
    from lidarcodec.commands import verify as command

    if not command.run(recording, source, calibration, as_json):
        raise typer.Exit(FAILED)


@app.command()
def annotate(
    source: Source,
    out: Annotated[Path, _option("--out", metavar="DIR", show_default=False, help="Folder; taken up if begun.")],
    poses: PosesFile = None,
    refine: Annotated[
        bool | None,
        _option("--refine/--no-refine", show_default=False, help="Align poses with the map; of files: yes."),
    ] = None,
    odometry: Annotated[str | None, _option("--odometry", metavar="NAME", help="auto, small_gicp or kiss-icp.")] = None,
    ground: Annotated[str, _option("--ground", metavar="NAME", help="ransac or patchwork.")] = "ransac",
    share: Annotated[float, _option("--share", help="Of all returns, those to be labelled high.")] = 1 / 12,
    every: Annotated[int, _option("--every", metavar="N", help="The map is of every N-th scan.")] = 5,
    travel: Annotated[float, _option("--travel", metavar="M", help="Least way between poses that count.")] = 0.5,
    label_every: Annotated[int, _option("--label-every", metavar="N", help="Label every N-th scan.")] = 1,
    workers: Annotated[int, _option("--workers", min=1, metavar="N", help="Processes to work in.")] = 1,
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
    codec: Annotated[str | None, _option("--codec", metavar="NAME[,NAME...]", help="Default: pcodec.")] = None,
    pairs: Annotated[
        list[str] | None,
        _option("--set", metavar="KEY=A[,B,C]", help="A setting; several values sweep. Repeatable: all combinations."),
    ] = None,
    reduction: ReductionName = None,
    keep_points: KeepPoints = None,
    keep_fraction: KeepFraction = None,
    frames: FrameCount = None,
    skip: SkipCount = 0,
    calibration: CalibrationFile = None,
    poses: PosesFile = None,
    plot: Annotated[
        Path | None, _option("--plot", metavar="FILE", help="Also draw the results (extra `plot`).")
    ] = None,
    metrics: Annotated[
        str, _option("--metrics", metavar="usual|all", help="`all`: also errors by range, Chamfer, D1, D2 (slower).")
    ] = "usual",
    curve: Annotated[
        bool, _option("--curve", help="Every codec at the points of its own knob: bound, quality or crf.")
    ] = False,
    peers: Annotated[
        bool, _option("--peers", help="Also other people's coders (extra `peers`); --codec peer:NAME takes one.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Measure codecs on a source: bits by plane, errors, times. Every message is decoded and compared."""
    from lidarcodec.commands import bench as command

    pairs = reduced(pairs, reduction, keep_points, keep_fraction)
    command.run(source, codec, pairs, frames, skip, calibration, poses, plot, as_json, metrics, curve, peers)


@app.command()
def simulate(
    source: Annotated[str, typer.Argument(metavar="sim:SCENE", show_default=False)],
    out: Annotated[Path, typer.Argument(metavar="OUT.pcap", show_default=False)],
    frames: FrameCount = None,
) -> None:
    """Write a simulated drive as a capture: sim:city, sim:road or sim:street, with ?seed=1&frames=100."""
    from lidarcodec.commands import simulate as command

    command.run(source, out, frames)


Connect = Annotated[
    list[str] | None,
    _option("--connect", metavar="ENDPOINT", help="Where others listen, such as tcp/192.168.1.5:7447. Repeatable."),
]
Listen = Annotated[
    list[str] | None,
    _option("--listen", metavar="ENDPOINT", help="Where to listen; without any, nothing leaves this machine."),
]
ZenohConfig = Annotated[
    Path | None, _option("--zenoh-config", metavar="FILE", help="A whole Zenoh configuration (JSON5), used as it is.")
]


@app.command()
def publish(
    source: Annotated[
        str | None, typer.Argument(metavar="[SOURCE]", show_default=False, help="A path, udp://HOST:PORT, sim:...")
    ] = None,
    vehicle: Annotated[
        str | None, _option("--vehicle", metavar="NAME", help="Default: whom --zenoh-config is for, else vehicle.")
    ] = None,
    sensor: Annotated[str | None, _option("--sensor", metavar="NAME", help="Default: lidar.")] = None,
    codec: CodecName = None,
    pairs: Pairs = None,
    reduction: ReductionName = None,
    keep_points: KeepPoints = None,
    keep_fraction: KeepFraction = None,
    rate: Annotated[
        str | None,
        _option("--rate", metavar="HZ|max", help="Frames a second of a recorded source (default 10), or every one."),
    ] = None,
    connect: Connect = None,
    listen: Listen = None,
    zenoh_config: ZenohConfig = None,
    record: Annotated[
        Path | None, _option("--record", metavar="DIR", help="Keep everything, whatever is sent.")
    ] = None,
    record_as: Annotated[
        str | None, _option("--record-as", metavar="packets|lossless", help="In which form; default: packets.")
    ] = None,
    record_gb: Annotated[
        float | None,
        _option("--record-gb", min=0.001, max=1e6, metavar="N", help="Size of DIR (8); the oldest files go first."),
    ] = None,
    calibration: CalibrationFile = None,
    poses: PosesFile = None,
    config: Annotated[
        Path | None, _option("--config", metavar="FILE", help="Several sensors, with all of this, from a YAML file.")
    ] = None,
) -> None:
    """Publish a source over Zenoh, newest frame first, until it ends or a signal comes."""
    from lidarcodec.commands import publish as command

    _keep_standard_output()
    if config is not None:
        from lidarcodec.commands import publish_config

        command.check_alone(
            {
                "SOURCE": source, "--sensor": sensor, "--codec": codec, "--set": pairs, "--reduction": reduction,
                "--keep-points": keep_points, "--keep-fraction": keep_fraction, "--rate": rate,
                "--record": record, "--record-as": record_as, "--record-gb": record_gb,
                "--calibration": calibration, "--poses": poses,
            }
        )  # fmt: skip
        publish_config.run(config, vehicle, (connect or [], listen or [], zenoh_config))
        return
    if source is None:
        raise SettingsError("publish what? give a SOURCE, or --config FILE", "source")
    command.run(
        source, vehicle, sensor or "lidar", codec, reduced(pairs, reduction, keep_points, keep_fraction), rate,
        (connect or [], listen or [], zenoh_config),
        record, record_as or "packets", 8.0 if record_gb is None else record_gb, calibration, poses,
    )  # fmt: skip


@app.command()
def subscribe(
    key: Annotated[
        str, typer.Argument(metavar="[KEY]", help="lidarcodec/v1/VEHICLE/SENSOR, or VEHICLE/SENSOR.")
    ] = "lidarcodec/v1/vehicle/lidar",
    udp: Annotated[
        str | None, _option("--udp", metavar="HOST:PORT", help="Send the decoded packets on, as the sensor would.")
    ] = None,
    record: Annotated[Path | None, _option("--record", metavar="DIR", help="Keep the messages as recordings.")] = None,
    frames: FrameCount = None,
    until_end: Annotated[bool, _option("--until-end", help="Stop when the publisher has gone.")] = False,
    receiver: Annotated[
        str | None,
        _option("--receiver", metavar="NAME", help="Whose reports these are; default: whom --zenoh-config is for."),
    ] = None,
    connect: Connect = None,
    listen: Listen = None,
    zenoh_config: ZenohConfig = None,
    as_json: AsJson = False,
) -> None:
    """Receive and decode a stream until a signal comes, and say how it went."""
    from lidarcodec.commands import subscribe as command

    _keep_standard_output()
    command.run(key, udp, record, frames, until_end, receiver, (connect or [], listen or [], zenoh_config), as_json)


@app.command()
def swarm(
    count: Annotated[int, typer.Argument(metavar="N", min=1, max=1000, show_default=False)],
    source: Annotated[str, typer.Argument(metavar="[SOURCE]")] = "sim:city",
    vehicle_prefix: Annotated[
        str, _option("--vehicle-prefix", metavar="NAME", help="Of NAME-001, NAME-002 ...")
    ] = "car",
    codec: CodecName = None,
    pairs: Pairs = None,
    rate: Annotated[float, _option("--rate", min=0.01, max=1000.0, metavar="HZ", help="Frames a second.")] = 10.0,
    frames: Annotated[int, _option("--frames", min=1, max=1000, metavar="N", help="Of SOURCE, over and over.")] = 50,
    shared: Annotated[
        bool, _option("--shared", help="Encode once and send that for all: little load here, all of it there.")
    ] = False,
    processes: Annotated[
        int | None, _option("--processes", min=1, max=64, metavar="N", help="Default: one a processor.")
    ] = None,
    seconds: Annotated[float | None, _option("--seconds", min=0.1, metavar="N", help="Default: until stopped.")] = None,
    connect: Connect = None,
    listen: Listen = None,
    zenoh_config: ZenohConfig = None,
    first: Annotated[int, _option("--first", min=0, max=10**6, metavar="N", help="Number of the first vehicle.")] = 1,
) -> None:
    """Publish as many vehicles at once, to load a network, a router or a server."""
    from lidarcodec.commands import swarm as command

    _keep_standard_output()
    given = (connect or [], listen or [], zenoh_config)
    load = command.Load(count, source, vehicle_prefix, codec, pairs or [], rate, frames, shared, seconds, given, first)
    command.run(load, processes)


@app.command()
def certs(
    folder: Annotated[Path, typer.Argument(metavar="DIR", show_default=False)],
    router: Annotated[
        list[str] | None, _option("--router", metavar="HOST", help="Where a Zenoh router listens. Repeatable.")
    ] = None,
    vehicle: Annotated[
        list[str] | None,
        _option("--vehicle", metavar="NAME[@HOST]", help="Publishes its own streams only. Repeatable."),
    ] = None,
    viewer: Annotated[list[str] | None, _option("--viewer", metavar="NAME", help="Receives. Repeatable.")] = None,
    operator: Annotated[
        list[str] | None, _option("--operator", metavar="NAME", help="Also changes settings. Repeatable.")
    ] = None,
    remove: Annotated[
        list[str] | None, _option("--remove", metavar="NAME", help="May do nothing any more. Repeatable.")
    ] = None,
    auth: Annotated[
        str | None,
        _option("--auth", metavar="certificate|password|none", help="How those who connect are known."),
    ] = None,
    port: Annotated[int | None, _option("--port", min=1, max=65535, help="Default: 7447.")] = None,
    days: Annotated[int, _option("--days", min=1, max=3650, help="How long certificates are valid.")] = 365,
    installed: Annotated[
        Path | None, _option("--installed", metavar="DIR", help="Where users.txt will lie on the router.")
    ] = None,
) -> None:
    """Make or extend a secured deployment: an authority, and one Zenoh configuration for each machine and person."""
    from lidarcodec.commands import certs as command

    command.run(
        folder, router or [], vehicle or [], viewer or [], operator or [], remove or [], auth, port, days, installed
    )


@app.command()
def serve(
    host: Annotated[str | None, _option("--host", metavar="H", help="Where to listen; default: 127.0.0.1.")] = None,
    port: Annotated[int | None, _option("--port", min=0, max=65535, metavar="P", help="Default: 8080.")] = None,
    database_url: Annotated[
        str | None, _option("--database-url", metavar="URL", help="Default: an SQLite file in the user's state folder.")
    ] = None,
    tls_certificate: Annotated[Path | None, _option("--tls-certificate", metavar="FILE", help="Serve HTTPS.")] = None,
    tls_key: Annotated[Path | None, _option("--tls-key", metavar="FILE", help="The key of --tls-certificate.")] = None,
    insecure: Annotated[
        bool, _option("--insecure", help="Listen beyond this machine although there is no token.")
    ] = False,
    metrics_open: Annotated[bool, _option("--metrics-open", help="Answer /metrics without a token.")] = False,
    max_streams: Annotated[int | None, _option("--max-streams", min=1, metavar="N", help="Default: 256.")] = None,
    max_viewers: Annotated[
        int | None, _option("--max-viewers", min=1, metavar="N", help="Live sockets at once; default: 64.")
    ] = None,
    recordings: Annotated[
        Path | None, _option("--recordings", metavar="DIR", help="Default: in the user's state folder.")
    ] = None,
    recordings_gb: Annotated[
        float | None,
        _option("--recordings-gb", min=0.001, max=1e6, metavar="N", help="Size of that folder; default: 64."),
    ] = None,
    connect: Connect = None,
    listen: Listen = None,
    zenoh_config: ZenohConfig = None,
) -> None:
    """Serve the streams of a fleet over HTTP until a signal comes: look at them, change them (extra `server`)."""
    from lidarcodec.commands import serve as command

    _keep_standard_output()
    command.run(
        (connect or [], listen or [], zenoh_config),
        host=host, port=port, database_url=database_url, tls_certificate=tls_certificate, tls_key=tls_key,
        insecure=insecure, metrics_open=metrics_open, max_streams=max_streams, max_viewers=max_viewers,
        recordings=recordings,
        max_recordings_bytes=None if recordings_gb is None else int(recordings_gb * 2**30),
    )  # fmt: skip


@app.command()
def demo(
    seconds: Annotated[float, _option("--seconds", min=1, metavar="N", help="How long.")] = 20.0,
    source: Annotated[str, _option("--source", metavar="SOURCE", help="What the vehicle sees.")] = "sim:city",
    codec: CodecName = None,
    pairs: Pairs = None,
    calibration: CalibrationFile = None,
    no_browser: Annotated[bool, _option("--no-browser", hidden=True)] = False,
    port: Annotated[int | None, _option("--port", hidden=True)] = None,
) -> None:
    """Drive through a simulated town, live: a publisher and a subscriber, a table, and a picture at the end."""
    del no_browser, port
    from lidarcodec.commands import demo as command

    _keep_standard_output()
    command.run(seconds, source, codec, pairs or [], calibration)


def _one_line(error: BaseException) -> str:
    text = " ".join(str(error).split()) or type(error).__name__
    if isinstance(error, OSError) and error.errno == errno.ENOSPC and error.filename is None:
        text = f"{error.strerror}: what was written before is kept; make room or write elsewhere"
    elif isinstance(error, OSError) and error.strerror and error.filename is not None:
        text = f"{error.filename}: {error.strerror}"
    return text


def _complain(error: BaseException) -> int:
    """Say in one line what is wrong; the exit code for it."""
    if isinstance(error, typer.TyperException):
        context = getattr(error, "ctx", None)
        path = context.command_path if context else "lidarcodec"
        text = " ".join(error.format_message().split()).rstrip(".")
        sys.stderr.write(f"{path}: {text} (see: {path} --help)\n")
        return WRONG_USAGE
    known = isinstance(error, LidarCodecError | OSError)
    text = _one_line(error) if known else f"unexpected {type(error).__name__}: {_one_line(error)}; --debug shows where"
    sys.stderr.write(f"lidarcodec: {text}\n")
    return WRONG_USAGE if isinstance(error, SettingsError | UnknownNameError) else FAILED


def _flush() -> None:
    """Write out what was printed; a stream is None where the caller closed it (`>&-`)."""
    for stream in (sys.stdout, sys.stderr):
        if stream is not None:
            stream.flush()


def run(arguments: list[str]) -> int:
    """Run one command; its exit code."""
    debug = "--debug" in arguments or os.environ.get("LIDARCODEC_DEBUG", "0") not in ("", "0")
    given = [word for word in arguments if word != "--debug"]
    logging.basicConfig(level=logging.WARNING, format="lidarcodec: warning: %(message)s")
    Interrupter().install()
    try:
        code = app(given, prog_name="lidarcodec", standalone_mode=False)
        _flush()
    except KeyboardInterrupt:
        return DONE
    except (BrokenPipeError, SystemExit):  # typer ends the process when it sees a broken pipe
        # Whoever read our output has seen enough; the interpreter flushes once more at exit, and must not complain.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return DONE
    except Exception as error:
        if not debug:
            return _complain(error)
        traceback.print_exception(error)
        return WRONG_USAGE if isinstance(error, SettingsError | UnknownNameError | typer.TyperException) else FAILED
    return DONE if code in (None, _STOPPED) else int(code)


def _keep_standard_output() -> None:
    """Keep standard output for what we print: the network library writes its log there, past Python."""
    _flush()
    ours = os.dup(1)
    os.dup2(2, 1)
    sys.stdout = os.fdopen(ours, "w", encoding=sys.stdout.encoding, errors=sys.stdout.errors)
    sys.stdout.reconfigure(line_buffering=sys.stdout.isatty())


def _open_standard_streams() -> None:
    """Give what was closed before the start (`>&-`) a place to go; else the first socket would be standard output."""
    while (number := os.open(os.devnull, os.O_RDWR)) <= 2:
        os.set_inheritable(number, True)
    os.close(number)
    if sys.stdout is None:
        sys.stdout = os.fdopen(1, "w", closefd=False)
    if sys.stderr is None:
        sys.stderr = os.fdopen(2, "w", closefd=False)


def main() -> NoReturn:
    """The process: run the command of the command line and end."""
    _open_standard_streams()
    code = run(sys.argv[1:])
    with contextlib.suppress(OSError):
        _flush()
    if "zenoh" in sys.modules:
        # Its threads outlive a closed session by a moment. One that asks for the interpreter while that ends aborts the
        # whole process ("FATAL: exception not rethrown"), so it does not end: everything of ours is closed by now.
        os._exit(code)
    sys.exit(code)


if __name__ == "__main__":
    main()

"""Commands of a live stream: publish, subscribe and demo."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from typer import Option

from lidarcodec.commands.results.live import Received, Shown, Streams
from lidarcodec.commands.running.run import keep_standard_output
from lidarcodec.commands.running.telling import prints
from lidarcodec.commands.signatures.common import (
    AsJson,
    CalibrationFile,
    CodecName,
    Connect,
    FrameCount,
    Listen,
    ModelName,
    MountText,
    Pairs,
    PosesOf,
    ReceiverName,
    UntilEnd,
    WithClouds,
    ZenohConfig,
    of_model,
)
from lidarcodec.commands.signatures.reduction import KeepFraction, KeepPoints, ReductionName, reduced
from lidarcodec.errors import SettingsError


@prints(Streams)
def publish(
    source: Annotated[
        str | None,
        typer.Argument(metavar="SOURCE", show_default=False, help="A path, udp://HOST:PORT, or sim:SCENE."),
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
    loop: Annotated[bool, Option("--loop", help="Begin again at the end of a recorded source.")] = False,
    connect: Connect = None,
    listen: Listen = None,
    zenoh_config: ZenohConfig = None,
    record: Annotated[
        Path | None,
        Option("--record", metavar="DIR", help="Also record the whole stream into DIR, independently of the network."),
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
    keep: Annotated[
        str | None,
        Option(
            "--keep",
            metavar="SIZE",
            help="Keep the last hours exactly, in at most this size, for example 64GB. `lidarcodec fetch` gets parts.",
        ),
    ] = None,
    keep_dir: Annotated[
        Path | None,
        Option("--keep-dir", metavar="DIR", help="Folder for --keep. Default: in the user's state folder."),
    ] = None,
    mark_when: Annotated[
        list[str] | None,
        Option(
            "--mark-when",
            metavar="CONDITION",
            help="Do not overwrite what was kept around such an event, for example 'worker_restarts grows'. "
            "Repeatable.",
        ),
    ] = None,
    calibration: CalibrationFile = None,
    model: ModelName = None,
    poses: Annotated[
        Path | None,
        Option(
            "--poses",
            metavar="FILE|source",
            help="Poses to send: a file (.npz, TUM or KITTI), or `source` for the poses in the source.",
        ),
    ] = None,
    mount: MountText = None,
    poses_of: PosesOf = None,
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
    as_json: AsJson = False,
) -> None:
    """Publish a source over Zenoh. A newer frame replaces one that waits. Stops when the source ends, or with
    Ctrl-C.
    """
    from lidarcodec.commands.publish import command
    from lidarcodec.sources.mounts import Mounted

    keep_standard_output()
    if config is not None:
        from lidarcodec.commands.publish import config as publish_config

        command.check_alone(
            {
                "SOURCE": source, "--sensor": sensor, "--link": link, "--codec": codec, "--set": pairs,
                "--reduction": reduction, "--keep-points": keep_points, "--keep-fraction": keep_fraction,
                "--rate": rate, "--record": record, "--record-as": record_as, "--record-gb": record_gb,
                "--keep": keep, "--keep-dir": keep_dir, "--mark-when": mark_when,
                "--calibration": calibration, "--model": model, "--poses": poses, "--original": original,
                "--mount": mount, "--poses-of": poses_of,
                "--loop": loop,
            }
        )  # fmt: skip
        given = (connect or [], listen or [], zenoh_config)
        publish_config.run(config, vehicle, given, health_file, weights_dir, as_json)
        return
    if source is None:
        raise SettingsError("nothing to publish: give a SOURCE, or --config FILE", "source")
    if record is None and (record_as is not None or record_gb is not None):
        raise SettingsError("--record-as and --record-gb need --record DIR", "record")
    if keep is None and (keep_dir is not None or mark_when):
        raise SettingsError("--keep-dir and --mark-when need --keep SIZE", "keep")
    command.run(
        of_model(source, model),
        vehicle=vehicle,
        sensor=sensor or "lidar",
        codec=codec,
        pairs=reduced(pairs, reduction, keep_points, keep_fraction),
        rate=rate,
        given=(connect or [], listen or [], zenoh_config),
        record=record,
        record_as=record_as or "packets",
        record_gb=8.0 if record_gb is None else record_gb,
        keep=keep,
        keep_dir=keep_dir,
        mark_when=tuple(mark_when or ()),
        calibration=calibration,
        poses=poses,
        health_file=health_file,
        original=original,
        weights_dir=weights_dir,
        link=link,
        loop=loop,
        as_json=as_json,
        mounted=Mounted.of(
            mount, poses_of, poses=poses is not None and poses != command.OWN_POSES, sensor=sensor or "lidar"
        ),
    )


@prints(Received)
def subscribe(
    key: Annotated[
        str, typer.Argument(metavar="KEY", help="lidarcodec/v1/VEHICLE/SENSOR, or VEHICLE/SENSOR.")
    ] = "lidarcodec/v1/vehicle/lidar",
    udp: Annotated[
        str | None,
        Option("--udp", metavar="HOST:PORT", help="Send the decoded packets to this address, as the sensor would."),
    ] = None,
    record: Annotated[
        Path | None, Option("--record", metavar="DIR", help="Record the received messages into DIR.")
    ] = None,
    with_clouds: WithClouds = False,
    refine: Annotated[
        bool,
        Option(
            "--refine",
            help="Also receive the refinements of a stream with base_error_m. Packets are then "
            "exact, up to a frame later.",
        ),
    ] = False,
    frames: FrameCount = None,
    until_end: UntilEnd = False,
    receiver: ReceiverName = None,
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
    command.run(key, udp, record, frames, until_end, receiver, given, as_json, with_clouds, refine)


@prints(Shown)
def demo(
    seconds: Annotated[
        float | None,
        Option("--seconds", min=1, metavar="N", help="Duration. Default: 20 s; on a terminal until Ctrl-C."),
    ] = None,
    source: Annotated[str, Option("--source", metavar="SOURCE", help="What the vehicle publishes.")] = "sim:city",
    codec: CodecName = None,
    pairs: Pairs = None,
    calibration: CalibrationFile = None,
    model: ModelName = None,
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
    as_json: AsJson = False,
) -> None:
    """Show a simulated drive live in the browser. Runs a vehicle and a server, and prints a summary at the end."""
    from lidarcodec.commands import demo as command

    keep_standard_output()
    command.run(seconds, of_model(source, model), codec, pairs or [], calibration, port=port, browser=not no_browser,
                as_json=as_json)  # fmt: skip

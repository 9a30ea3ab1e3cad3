"""The options of `lidarcodec convert`, and the choice between packets and frames."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer
from typer import Option

from lidarcodec.commands.results.files import Converted
from lidarcodec.commands.running.run import keep_standard_output
from lidarcodec.commands.running.telling import prints
from lidarcodec.commands.signatures.common import (
    AllowMissed,
    AsJson,
    CalibrationFile,
    CodecName,
    Connect,
    Force,
    FrameCount,
    Listen,
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
    ZenohConfig,
    of_model,
)
from lidarcodec.commands.signatures.selecting import FromTime, Merge, Region, ToTime, Transform, WhichReturns
from lidarcodec.errors import SettingsError

STREAM = "zenoh:"
"""Beginning of a SOURCE that is a live stream: `zenoh:VEHICLE/SENSOR`."""


@prints(Converted)
def convert(
    source: Source,
    out: Annotated[
        Path,
        typer.Argument(
            metavar="OUT",
            show_default=False,
            help="A file that ends in .pcap .mcap .npz .ply .pcd .las .laz .csv or .e57, or a folder.",
        ),
    ],
    form: Annotated[
        str | None,
        Option(
            "--as",
            metavar="FORMAT",
            help="Format: pcap, recording, packets, rosbag, messages, clouds, npz, ply, pcd, pcd-compressed, las, laz, "
            "csv, e57, kitti. Default: by the ending of OUT; a folder is a rosbag. With a folder, formats of points "
            "give a file for each frame.",
        ),
    ] = None,
    begin: FromTime = None,
    end: ToTime = None,
    region: Region = None,
    transform: Transform = None,
    merge: Merge = False,
    returns: WhichReturns = "first",
    vehicle: RecordedVehicle = None,
    sensor: RecordedSensor = None,
    codec: CodecName = None,
    pairs: Pairs = None,
    with_clouds: WithClouds = False,
    topic: Annotated[
        str | None,
        Option(
            "--topic",
            metavar="NAME",
            help="Topic of the packets in a rosbag. Default: /velodyne_packets. Of --as clouds: of the points, "
            "/points. Messages are on NAME/lidarcodec.",
        ),
    ] = None,
    frame_id: Annotated[
        str | None,
        Option(
            "--frame-id",
            metavar="NAME",
            help="frame_id in a rosbag. Default: velodyne, the model of another sensor, or VEHICLE/SENSOR of messages.",
        ),
    ] = None,
    allow_missed: AllowMissed = False,
    force: Force = False,
    frames: FrameCount = None,
    skip: SkipCount = 0,
    calibration: CalibrationFile = None,
    model: ModelName = None,
    poses: PosesFile = None,
    mount: MountText = None,
    poses_of: PosesOf = None,
    connect: Connect = None,
    listen: Listen = None,
    zenoh_config: ZenohConfig = None,
    as_json: AsJson = False,
) -> None:
    """Convert any source to packets, a recording, a rosbag2, images or points. Packets do not change."""
    from lidarcodec.commands.convert import convert as packets
    from lidarcodec.commands.convert import messages
    from lidarcodec.commands.convert.frames import Wanted, receive
    from lidarcodec.commands.convert.frames import convert as write_frames
    from lidarcodec.commands.convert.outputs import FORMS
    from lidarcodec.commands.convert.outputs import form_of as packet_form_of
    from lidarcodec.commands.endpoints import endpoints_of
    from lidarcodec.commands.outputs.base import BagNames
    from lidarcodec.commands.outputs.table import form_of
    from lidarcodec.commands.selection.frames import Selection
    from lidarcodec.commands.selection.points import Placing
    from lidarcodec.evaluation.coded_recording import Named
    from lidarcodec.sources.mounts import Mounted

    named = Named.of(vehicle, sensor)
    spec, selection = of_model(source, model), Selection(frames, skip, begin, end)
    placing = Placing.of(region, transform, merge=merge, returns=returns)
    if form == messages.FORM:
        messages.check_recording(spec, skip=skip, frames=frames, begin=begin, end=end)
        for name, other in (("--from", begin), ("--to", end), ("--skip", skip), ("--frames", frames),
                            ("--codec", codec), ("--set", pairs), ("--calibration", calibration), ("--poses", poses),
                            ("--with-clouds", with_clouds), (placing.given, placing.given), ("--model", model),
                            ("--mount", mount), ("--poses-of", poses_of), ("--allow-missed", allow_missed),
                            ("--connect", connect), ("--listen", listen),
                            ("--zenoh-config", zenoh_config), ("--vehicle", vehicle),
                            ("--sensor", sensor)):  # fmt: skip
            if other:
                raise SettingsError(
                    f"{name} is not for messages: leave it out, because a whole recording is copied as it is", "as"
                )
        messages.run(spec, out, topic, frame_id, force=force, as_json=as_json)
        return
    kept = packet_form_of(out, form)
    for name, text in (("--vehicle", vehicle), ("--sensor", sensor)):
        if text and kept not in ("recording", "packets"):
            raise SettingsError(f"{name} is only for recordings (.mcap): {out} cannot hold a name", name[2:])
    stream = source.removeprefix(STREAM)
    mounted_as = stream.rpartition("/")[2] if stream != source else sensor
    mounted = Mounted.of(mount, poses_of, poses=poses is not None, sensor=mounted_as)
    if kept is not None and stream != source:
        raise SettingsError(f"{source} gives points, not packets: `lidarcodec subscribe` has --record and --udp", "as")
    if kept is not None:
        if placing.given:
            raise SettingsError(f"{placing.given} is only for points, but {kept} holds packets", "region")
        packets.run(spec, out, form=kept, named=named, codec=codec, pairs=pairs or [], selection=selection,
                    calibration=calibration,
                    poses=poses, clouds=with_clouds, topic=topic, frame_id=frame_id, force=force,
                    allow_missed=allow_missed, as_json=as_json, mounted=mounted)  # fmt: skip
        return
    wanted = Wanted(out, form_of(out, form, further=FORMS), selection, placing, force, as_json)
    if wanted.form.is_bag:
        names = BagNames(None if topic is None else packets.ros_topic(topic), frame_id)
        wanted, topic, frame_id = replace(wanted, names=names), None, None
    for name, given in (("--codec", codec), ("--set", pairs), ("--with-clouds", with_clouds), ("--topic", topic),
                        ("--frame-id", frame_id), ("--allow-missed", allow_missed)):  # fmt: skip
        if given:
            raise SettingsError(f"{name} is not for {wanted.form.name}: it is for recordings or rosbags", "as")
    if stream == source:
        write_frames(spec, wanted, calibration, poses, mounted)
        return
    for name, value in (("--calibration", calibration), ("--model", model), ("--poses", poses)):
        if value is not None:
            raise SettingsError(
                f"{name} is not for a live stream, which brings this along: leave it out", name.lstrip("-")
            )
    keep_standard_output()
    receive(stream, wanted, endpoints_of((connect or [], listen or [], zenoh_config)), mounted.mount)

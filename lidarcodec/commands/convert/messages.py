"""`lidarcodec convert --as messages`: the messages of a recording for ROS 2 and Foxglove, byte for byte."""

from __future__ import annotations

import logging
from pathlib import Path
from shlex import quote
from typing import Final

from lidarcodec import wire
from lidarcodec.commands.convert.convert import ros_topic
from lidarcodec.commands.outputs.table import BAG_FILES
from lidarcodec.commands.progress import progress
from lidarcodec.commands.results.files import Converted
from lidarcodec.commands.running import remaining
from lidarcodec.commands.running.stopping import Watched, stoppable
from lidarcodec.commands.running.telling import tell
from lidarcodec.commands.sources import check_not_input
from lidarcodec.errors import DecodeError, SettingsError, SourceError
from lidarcodec.evaluation.coded_recording import SENSOR, VEHICLE
from lidarcodec.files.regular import open_regular
from lidarcodec.files.whole import check_free, whole
from lidarcodec.mounting.stream import MountMemory
from lidarcodec.planes.sections import pose_of
from lidarcodec.recording import RecordingReader, RosbagWriter
from lidarcodec.recording.rosbag import METADATA
from lidarcodec.sources.spec import parse
from lidarcodec.sources.table import kind_of

logger = logging.getLogger(__name__)

FORM: Final = "messages"
POINTS_TOPIC: Final = "/points"


def check_recording(spec: str, **selected: object) -> None:
    """Raises SettingsError if the source is no recording. selected: what was asked of it: that is for `encode`"""
    if kind_of(parse(spec)) == "recording":
        return
    names = {"skip": "--skip", "frames": "--frames", "begin": "--from", "end": "--to"}
    words = "".join(f" {names[name]} {value}" for name, value in selected.items() if value)
    raise SettingsError(
        f"--as {FORM} needs a recording, and takes all of it: write one first with `lidarcodec encode {quote(spec)} "
        f"OUT.mcap{words}`", "as"
    )  # fmt: skip


def run(spec: str, out: Path, topic: str | None, frame_id: str | None, *, force: bool, as_json: bool) -> None:
    """Write a bag with a CompressedPointCloud2 for each message, and `/tf` where messages carry poses.

    topic: of the points; that of the messages has `/lidarcodec` behind it.  frame_id: default is VEHICLE/SENSOR
    Messages that are damaged are left out, with a warning.
    """
    if out.suffix.lower() not in ("", ".mcap"):
        raise SettingsError(f"--as {FORM} does not fit {out}: give a name that ends in .mcap, or a folder", "as")
    parsed, topic = parse(spec), ros_topic(topic or POINTS_TOPIC)
    path = parsed.only().path
    check_not_input(out, spec)
    contents = None if out.suffix else BAG_FILES
    check_free(out, force=force, contents=contents)
    with (
        open_regular(path) as handle,
        stoppable() as stopped,
        progress("copying", None) as tick,
        whole(out, force=force, contents=contents) as output,
    ):
        reader = RecordingReader(handle)
        name = f"{reader.metadata.get('vehicle', VEHICLE)}/{reader.metadata.get('sensor', SENSOR)}"
        file = output.beside if out.suffix else output.beside / f"{out.name}_0.mcap"
        frames = size = left_out = 0
        with file.open("wb") as to:
            writer = RosbagWriter(to, points_topic=topic, frame_id=frame_id or name)
            watched, mounts = Watched(reader.messages(), stopped), MountMemory()
            for _, data in watched:
                try:
                    message = wire.unpack(data)
                    writer.write_coded(data, pose_of(message), mounts.read(message))
                except DecodeError:
                    left_out += 1
                    continue
                frames, size = frames + message.frame_count, size + len(data)
                tick()
            writer.close()
        if not frames:
            raise SourceError(f"{path} has no messages: {out} was not written")
        if not out.suffix:
            (output.beside / METADATA).write_text(writer.metadata(file.name))
        if watched.cut:
            output.only_part()
    kept = output.kept or out
    if left_out:
        logger.warning("%s: %d damaged messages were left out", path, left_out)
    if refinements := reader.refinements.untaken():
        logger.warning(
            "%s: %d refinements were left out: the bag holds the base of these frames, within base_error_m",
            path,
            refinements,
        )
    found = Converted(
        output=str(kept), form=FORM, files=sum(1 for _ in kept.iterdir()) if kept.is_dir() else 1, beside=[],
        frames=frames, packets=None, points=None, positions=0,
        bytes=kept.stat().st_size if kept.is_file() else None, coded_bytes=size,
    )  # fmt: skip
    topics = ", ".join(f"{one.count} {one.name}" for one in writer.topics)
    tell(found, f"{kept}: {frames} frames in {size:,} bytes of messages; {topics}", as_json)
    if watched.cut:
        raise remaining.stopped(out, kept, frames)

"""`lidarcodec convert`: any source into a capture, a recording or a rosbag2, packets byte for byte."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import chain
from pathlib import Path

from lidarcodec.assembly.any_sensor import TurnWatch
from lidarcodec.assembly.rotation import RotationWatch
from lidarcodec.commands import encode
from lidarcodec.commands.capture_records import named_beside, said_beside
from lidarcodec.commands.convert.described import check_beside, needs_file, write_beside
from lidarcodec.commands.convert.outputs import Bag, Form, Output, Wanted, open_output
from lidarcodec.commands.outputs.table import BAG_FILES
from lidarcodec.commands.progress import progress
from lidarcodec.commands.results.files import Converted
from lidarcodec.commands.running import remaining
from lidarcodec.commands.running.stopping import stoppable
from lidarcodec.commands.running.telling import tell
from lidarcodec.commands.selection.frames import Selection
from lidarcodec.commands.sources import check_finite, check_not_input, readable
from lidarcodec.commands.turns import Turns, turns_of
from lidarcodec.errors import SettingsError, SourceError
from lidarcodec.evaluation.coded_recording import UNNAMED, Named
from lidarcodec.files.whole import check_free, whole
from lidarcodec.recording.rosbag import METADATA
from lidarcodec.sensor_model import POINTCLOUD2, SensorModel
from lidarcodec.sensors.models.table import PACKETS, aside_name
from lidarcodec.sources import PacketSource, open_source
from lidarcodec.sources.described import description_of
from lidarcodec.sources.mounts import NOT_SAID, Mounted
from lidarcodec.sources.spec import parse
from lidarcodec.sources.unkept import say_unkept
from lidarcodec.units import FRAME_PACKETS, counted

logger = logging.getLogger(__name__)


def run(
    spec: str,
    out: Path,
    *,
    form: Form,
    codec: str | None,
    pairs: list[str],
    selection: Selection,
    calibration: Path | None,
    poses: Path | None,
    clouds: bool,
    topic: str | None,
    frame_id: str | None,
    force: bool,
    allow_missed: bool = False,
    as_json: bool = False,
    mounted: Mounted = NOT_SAID,
    named: Named = UNNAMED,
) -> None:
    """Convert packet by packet. OUT appears when it is complete; after a signal the finished part has another name.

    A recording is like one of `encode`, with its framing; for other formats a frame is a turn.
    """
    frames, skip = selection.frames, selection.skip
    wanted = _wanted(out, form, codec, pairs, clouds, topic, frame_id, named)
    check_finite(spec, frames)
    if wanted.form == "recording":
        encode.run(
            spec,
            out,
            codec=codec,
            pairs=pairs,
            selection=selection,
            calibration=calibration,
            poses=poses,
            clouds=clouds,
            learn=0,
            force=force,
            allow_missed=allow_missed,
            as_json=as_json,
            mounted=mounted,
            named=named,
        )
        return
    check_not_input(out, spec)
    contents = None if out.suffix else BAG_FILES
    check_free(out, force=force, contents=contents)
    with (
        open_source(spec, calibration=calibration, poses=poses, points=clouds) as source,
        stoppable(source.close if source.live else None) as stopped,
        progress("converting", frames) as tick,
        whole(out, force=force, contents=contents) as output,
    ):
        mounted.given_to(source)
        if wanted.form == "pcap" and source.sensor.is_cloud:
            raise SettingsError(
                "a capture (.pcap) cannot hold point clouds: write a rosbag2 instead (an output "
                "name without an ending)",
                "to",
            )
        read = parse(spec).path
        described = bool(out.suffix) or source.sensor.is_hdl64e
        beside = None
        if described:
            beside = check_beside(out, source.sensor, force=force, source=read if read.is_file() else None)
        of, watch = _turning(source.sensor, spec, numbered=frames is not None or skip > 0)
        turns = Turns(selection.in_time(source.packets()), stopped, tick, of, frames, watch)
        turns.pass_over(skip)
        packets = iter(turns)
        first = next(packets, None)
        if first is None and stopped():
            raise remaining.stopped(out, None, 0)
        if first is None:
            raise SourceError(f"{spec} has {selection.nothing()}: {out} was not written")
        about = {"source": readable(spec), "calibration": f"{source.sensor.origin} {source.sensor.hash}"}
        with _opened(out, output.beside, wanted, source, about) as writer:
            for packet in chain((first,), packets):
                writer.write(packet)
            said = writer.close()
        part = turns.cut or (source.live and stopped() and frames is not None and not turns.complete)
        # The calibration file of a stopped command is next to OUT, not next to the part that was kept.
        if part and described and beside is None:
            beside = description_of(source.sensor)
        if beside is not None and not needs_file(source.sensor, turns.packets):
            beside = None
        if beside is not None:
            write_beside(output, beside)
        if part:
            output.only_part()
    _say_left_out(source, clouds=wanted.clouds)
    kept = output.kept or out
    tables = [named_beside(kept, beside[0])] if beside is not None and out.suffix else []
    _tell(kept, wanted.form, turns, source.sensor, said, tables, as_json)
    _check_left_out(writer, kept)
    if part:
        raise remaining.stopped(out, kept, turns.turns, skip=skip, frames=frames, live=source.live)


def _say_left_out(source: PacketSource, *, clouds: bool) -> None:
    """Warn about what was not kept. clouds: whether clouds are written, too, with a transform for each"""
    say_unkept(source.label, source.counts)
    if source.carried is not None and source.carried.count and not clouds:
        logger.warning(
            "%s: the poses of %d frames were left out: packets have no place for them, but a recording has",
            source.label,
            source.carried.count,
        )


def _turning(sensor: SensorModel, spec: str, *, numbered: bool) -> tuple[int | None, RotationWatch | TurnWatch | None]:
    """Packets of a turn, and what sees where turns begin; 348 packets where none are seen.

    Raises SettingsError if turns are to be `numbered` there.
    """
    if sensor.model not in (PACKETS, POINTCLOUD2):
        return None, turns_of(sensor)
    if numbered:
        raise SettingsError(
            f"--frames and --skip count turns of the sensor, but none were found in {spec}: use --from and --to",
            "frames",
        )
    return FRAME_PACKETS, None


def _tell(
    kept: Path,
    form: Form,
    turns: Turns,
    sensor: SensorModel,
    said: str,
    tables: list[Path],
    as_json: bool,
) -> None:
    """Print what was written. tables: calibration and metadata beside it;  said: remark of the output"""
    count, positions = turns.packets, turns.positions
    what = "a rosbag2 (files of points: --as kitti, --as ply), " if form == "rosbag" and not kept.suffix else ""
    parts = [f"{kept}: {what}{counted(count, 'packet')}" + f", {counted(turns.turns, 'frame')}" * sensor.is_hdl64e]
    parts[0] += f", {counted(positions, aside_name(sensor.model))}" * bool(positions and form != "rosbag")
    parts += [said] if said else []
    parts += map(said_beside, tables)
    found = Converted(
        output=str(kept), form=form, files=sum(1 for _ in kept.iterdir()) if kept.is_dir() else 1,
        beside=[str(path) for path in tables],
        frames=turns.turns if sensor.is_hdl64e else None, packets=count, points=None,
        positions=positions, bytes=kept.stat().st_size if kept.is_file() else None,
    )  # fmt: skip
    tell(found, "; ".join(parts), as_json)


def _check_left_out(writer: Output, kept: Path) -> None:
    """Raises SourceError if packets are missing in the output."""
    if writer.left_out:
        raise SourceError(f"{writer.left_out} packets of another length were left out: {kept} cannot hold them")


def _wanted(
    out: Path,
    form: Form,
    codec: str | None,
    pairs: list[str],
    clouds: bool,
    topic: str | None,
    frame_id: str | None,
    named: Named,
) -> Wanted:
    """Raises SettingsError for options that do not apply to the output format."""
    if form != "recording" and (codec or pairs):
        raise SettingsError(f"--codec and --set are for recordings, but {out} holds the original packets", "codec")
    if form not in ("recording", "rosbag") and clouds:
        raise SettingsError(f"--with-clouds is for recordings and rosbags: a {form} file holds only packets", "clouds")
    if form != "rosbag" and (topic or frame_id):
        raise SettingsError(f"--topic and --frame-id are for rosbags, but {out} is not a rosbag", "topic")
    defaults = Wanted(form, clouds)
    return Wanted(form, clouds, ros_topic(topic or defaults.topic), frame_id or defaults.frame_id, named)


def ros_topic(topic: str) -> str:
    """The given topic. Raises SettingsError for a name that ROS does not know."""
    if not topic.startswith("/") or topic.endswith("/") or not topic.replace("/", "").replace("_", "").isalnum():
        raise SettingsError(f"--topic {topic} is not a ROS name: write /parts/of_letters_and_digits", "topic")
    return topic


@contextmanager
def _opened(out: Path, beside: Path, wanted: Wanted, source: PacketSource, about: dict[str, str]) -> Iterator[Output]:
    """The open output, written to the file or folder `beside`."""
    if out.suffix:
        with beside.open("wb") as handle:
            yield open_output(wanted, handle, source, about)
        return
    name = f"{out.name}_0.mcap"
    with (beside / name).open("wb") as handle:
        output = open_output(wanted, handle, source, about)
        yield output
    if isinstance(output, Bag):
        (beside / METADATA).write_text(output.writer.metadata(name))

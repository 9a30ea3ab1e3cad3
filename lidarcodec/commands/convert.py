"""`lidarcodec convert`: any source into a capture, a recording or a rosbag2, packets byte for byte."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from itertools import chain
from pathlib import Path

from lidarcodec.commands.converted import Bag, Form, Output, Wanted, form_of, open_output
from lidarcodec.commands.progress import progress
from lidarcodec.commands.settings import one_setting
from lidarcodec.commands.sources import check_finite, check_not_input, readable
from lidarcodec.commands.stopping import stoppable
from lidarcodec.commands.unkept import say_unkept
from lidarcodec.errors import CalibrationError, SettingsError, SourceError
from lidarcodec.packet import Packet, part_of
from lidarcodec.pipeline import check_offline
from lidarcodec.sensor_model import SensorModel
from lidarcodec.sensors import read_calibration, write_db_xml
from lidarcodec.sources import PacketSource, open_source
from lidarcodec.units import FRAME_PACKETS
from lidarcodec.whole_files import written_whole

METADATA, CALIBRATION = "metadata.yaml", "db.xml"
IN_THE_STREAM = ("generic", "stream")
"""Where a calibration came from that needs no file: nobody's, or in the packets themselves."""


class _StoppedError(Exception):
    """A signal came: what was begun is thrown away."""


def run(
    spec: str,
    out: Path,
    to: str | None,
    codec: str | None,
    pairs: list[str],
    frames: int | None,
    skip: int,
    calibration: Path | None,
    poses: Path | None,
    clouds: bool,
    topic: str | None,
    frame_id: str | None,
    force: bool,
) -> None:
    """Convert packet by packet. OUT is there whole at the end, or as it was before."""
    wanted = _wanted(out, form_of(out, to), codec, pairs, clouds, topic, frame_id)
    check_finite(spec, frames)
    check_not_input(out, spec)
    _check_free(out, force)
    limit = None if frames is None else frames * FRAME_PACKETS
    try:
        with (
            open_source(spec, calibration=calibration, poses=poses) as source,
            stoppable() as stopped,
            progress("converting", frames) as tick,
        ):
            beside = _calibration_file(out, wanted.form, source.sensor, force)
            skipped = skip * FRAME_PACKETS
            packets = part_of(source.packets(), skipped, limit)
            first = next(packets, None)
            if first is None:
                raise SourceError(f"{spec} has no packet behind the first {skip} frames: {out} was not written")
            about = {"source": readable(spec), "calibration": f"{source.sensor.origin} {source.sensor.hash}"}
            with _opened(out, wanted, source, about, force) as output:
                count, positions = _written(output, chain((first,), packets), tick, stopped)
                said = output.close()
            if beside is not None:
                write_db_xml(source.sensor, beside)
    except _StoppedError:
        print(f"stopped: {out} was not written")
        return
    say_unkept(source.label, source.counts)
    kept = "" if beside is None or beside.parent == out else f"; calibration in {beside}"
    more = f", {positions} position packets" * bool(positions and wanted.form != "rosbag")
    print(f"{out}: {count} packets, {count / FRAME_PACKETS:.1f} frames{more}{'; ' * bool(said)}{said}{kept}")


def _written(
    output: Output, packets: Iterable[Packet], tick: Callable[[], None], stopped: Callable[[], bool]
) -> tuple[int, int]:
    """How many data packets and position packets were written.

    Raises _StoppedError between two frames.
    """
    count = positions = 0
    for packet in packets:
        output.write(packet)
        if packet.position:
            positions += 1
            continue
        count += 1
        if count % FRAME_PACKETS == 0:
            tick()
            if stopped():
                raise _StoppedError
    return count, positions


def _wanted(
    out: Path, form: Form, codec: str | None, pairs: list[str], clouds: bool, topic: str | None, frame_id: str | None
) -> Wanted:
    """Raises SettingsError for options that this form has no use for."""
    if form != "recording" and (codec or pairs):
        raise SettingsError(f"--codec and --set are for recordings: {out} gets packets as they are", "codec")
    if form not in ("recording", "rosbag") and clouds:
        raise SettingsError(f"--with-clouds is for recordings and rosbags: a {form} file holds packets only", "clouds")
    if form != "rosbag" and (topic or frame_id):
        raise SettingsError(f"--topic and --frame-id are for rosbags, {out} is none", "topic")
    defaults = Wanted(form, check_offline(one_setting(codec, pairs)), clouds)
    topic = topic or defaults.topic
    if not topic.startswith("/") or topic.endswith("/") or not topic.replace("/", "").replace("_", "").isalnum():
        raise SettingsError(f"--topic {topic}: ROS names are /parts/of_letters_and_digits", "topic")
    return Wanted(form, defaults.settings, clouds, topic, frame_id or defaults.frame_id)


def _check_free(out: Path, force: bool) -> None:
    """Raise SettingsError if writing OUT would take the place of something that is to stay."""
    if not out.exists() and not out.is_symlink():
        return
    if not force:
        raise SettingsError(f"{out} exists: give another name, or --force to put the new one in its place", "force")
    if out.is_dir() and not (out / METADATA).is_file():
        raise SettingsError(f"{out} is a folder and no rosbag2: not even --force replaces that")


def _calibration_file(out: Path, form: Form, sensor: SensorModel, force: bool) -> Path | None:
    """Where the calibration is kept so that it is found again with OUT; None if that is not needed, or done already.

    Raises SettingsError if another one is in the way.
    """
    if form == "recording" or sensor.origin in IN_THE_STREAM:
        return None
    if not out.suffix:
        return out / CALIBRATION
    path = out.with_name(f"{out.stem}_{CALIBRATION}")
    if not path.exists() or force:
        return path
    try:
        same = bool((read_calibration(path, "beside").calibration.table == sensor.calibration.table).all())
    except CalibrationError:
        same = False
    if not same:
        raise SettingsError(f"{path} is another calibration than that of {out}: --force replaces it", "force")
    return None


@contextmanager
def _opened(out: Path, wanted: Wanted, source: PacketSource, about: dict[str, str], force: bool) -> Iterator[Output]:
    """The output, on files that get their names when all went well."""
    if out.suffix:
        with written_whole(out) as path, path.open("wb") as handle:
            yield open_output(wanted, handle, source.sensor, about, source.poses)
        return
    with _folder_written_whole(out, force) as folder:
        name = f"{out.name}_0.mcap"
        with (folder / name).open("wb") as handle:
            output = open_output(wanted, handle, source.sensor, about, source.poses)
            yield output
        if isinstance(output, Bag):
            (folder / METADATA).write_text(output.writer.metadata(name))


@contextmanager
def _folder_written_whole(out: Path, force: bool) -> Iterator[Path]:
    """A folder beside `out` to write to, renamed to it at the end; nothing is left behind if that does not come.

    Raises SourceError when it cannot be written.
    """
    try:
        beside = Path(tempfile.mkdtemp(prefix=f".{out.name}.", dir=out.parent))
        try:
            yield beside
            beside.chmod(0o755)
            if force and out.exists():
                before = Path(tempfile.mkdtemp(prefix=f".{out.name}.", dir=out.parent))
                out.replace(before / out.name)
                beside.replace(out)
                shutil.rmtree(before)
            else:
                beside.rename(out)
        except BaseException:
            shutil.rmtree(beside, ignore_errors=True)
            raise
    except OSError as error:
        raise SourceError(f"cannot write {out}: {error.strerror or error}") from None

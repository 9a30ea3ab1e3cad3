"""`lidarcodec publish`: publishes a source live to all subscribers."""

from __future__ import annotations

import os
import sys
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import Any, cast

from lidarcodec.apps.health import SensorState, health_file_or_nothing
from lidarcodec.apps.notify import told_ready
from lidarcodec.apps.past.keeper import Keep, bytes_of
from lidarcodec.apps.publisher.publisher import Publisher, Rate
from lidarcodec.apps.recorder import Record, RecordAs
from lidarcodec.commands.endpoints import Given, endpoints_of
from lidarcodec.commands.running.stopping import stoppable
from lidarcodec.commands.running.telling import tell
from lidarcodec.commands.settings import one_setting
from lidarcodec.commands.unkept import check_recorded
from lidarcodec.errors import SettingsError
from lidarcodec.network.shelf import look_in
from lidarcodec.ratecontrol.presets import preset
from lidarcodec.settings import AUTO
from lidarcodec.sources import PacketSource, open_source
from lidarcodec.sources.mounts import NOT_SAID, Mounted
from lidarcodec.sources.unkept import say_unkept
from lidarcodec.transport import Endpoints, party_of
from lidarcodec.units import counted

OWN_POSES = Path("source")
MIN_FILE_BYTES, MAX_FILE_BYTES = 2**20, 256 * 2**20


def rate_of(text: str | None) -> Rate | None:
    """Frames a second, or `max`.

    Raises SettingsError for any other text.
    """
    if text is None or text == "max":
        return cast(Rate | None, text)
    try:
        rate = float(text)
    except ValueError:
        rate = 0.0
    if not 0.01 <= rate <= 1000.0:
        raise SettingsError(f"--rate {text}: write frames a second, from 0.01 to 1000, or max", "rate")
    return rate


def past_folder() -> Path:
    """Default folder of what is kept: `lidarcodec/past` in the user's state folder."""
    base = os.environ.get("XDG_STATE_HOME", "")
    return (Path(base) if base else Path.home() / ".local" / "state") / "lidarcodec" / "past"


def record_limits(gigabytes: float) -> dict[str, int]:
    """Limits of the recorder for a folder of `gigabytes` GB: files of 256 MiB, or smaller files in a small folder."""
    total = int(gigabytes * 1e9)
    return {"max_total_bytes": total, "max_file_bytes": max(min(MAX_FILE_BYTES, total // 4), MIN_FILE_BYTES)}


def vehicle_of(given: str | None, endpoints: Endpoints) -> str:
    """The name of the vehicle: the given one, otherwise the name in the Zenoh configuration, otherwise `vehicle`.

    Raises SettingsError if the given name differs from the configuration: routers would drop its messages silently.
    """
    party = party_of(endpoints)
    if party is None:
        return given or "vehicle"
    if party.role != "vehicle" or given not in (None, party.name):
        as_whom = "publish" if given is None else f"publish as {given}"
        raise SettingsError(
            f"{endpoints.config} is the configuration of {party.role} {party.name}, which is not allowed to {as_whom}",
            "vehicle",
        )
    return party.name


def check_alone(given: dict[str, object]) -> None:
    """Raise SettingsError if an option was given that belongs into the file of --config."""
    for name, value in given.items():
        if value:
            raise SettingsError(f"{name} cannot be combined with --config: write it into that file", "config")


def run(
    spec: str,
    *,
    vehicle: str | None,
    sensor: str,
    codec: str | None,
    pairs: list[str],
    rate: str | None,
    given: Given,
    record: Path | None,
    record_as: str,
    record_gb: float,
    keep: str | None,
    keep_dir: Path | None,
    mark_when: tuple[str, ...],
    calibration: Path | None,
    poses: Path | None,
    health_file: Path | None,
    original: bool,
    weights_dir: Path | None,
    link: str | None = None,
    loop: bool = False,
    as_json: bool = False,
    mounted: Mounted = NOT_SAID,
) -> None:
    """Publish until the source ends or a signal arrives."""
    if record_as not in ("packets", "lossless"):
        raise SettingsError(f"--record-as must be packets or lossless, not '{record_as}'", "record_as")
    if weights_dir is not None:
        look_in(weights_dir)
    settings = one_setting(codec, pairs, link)
    if link is not None:
        print(f"--link {link} sets {preset(link).told(settings)}", file=sys.stderr)
    endpoints, frames_a_second = endpoints_of(given), rate_of(rate)
    own_poses = poses == OWN_POSES
    with open_source(spec, calibration=calibration, poses=None if own_poses else poses) as source:
        check_loop(source, loop)
        mounted.given_to(source)
        if own_poses and source.poses is None:
            raise SettingsError(f"{spec} has no poses of its own: give a file with --poses FILE", "poses")
        publisher = Publisher(
            source,
            settings,
            vehicle=vehicle_of(vehicle, endpoints),
            sensor=sensor,
            rate=frames_a_second,
            loop=loop,
            endpoints=endpoints,
            keep=None if keep is None else Keep(keep_dir or past_folder(), bytes_of(keep), mark_when),
            record=None if record is None else Record(record, cast(RecordAs, record_as), record_limits(record_gb)),
            poses=source.poses if poses else None,
            original=original,
        )
        health = health_file_or_nothing(health_file, lambda: [SensorState.of(publisher.status())])
        stream = f"{publisher.keys.vehicle}/{publisher.keys.sensor}"
        ready = told_ready(f"publishing {stream}", publisher.status)
        with stoppable(publisher.interrupt), health, publisher, ready:
            say_begun([stream], endpoints, waits=frames_a_second == "max" and not source.live)
            publisher.wait()
        if publisher.failure is not None:
            raise publisher.failure
    say_unkept(spec, Counter(publisher.status()["source"]))
    tell_of([publisher.status()], as_json)


def say_begun(streams: Iterable[str], endpoints: Endpoints, *, waits: bool = False) -> None:
    """Say what is published, because nothing else is printed until the end.

    waits: nothing is sent before there is a receiver
    """
    elsewhere = " on this machine only, to all its users (--connect or --listen sends it elsewhere)"
    reach = elsewhere if endpoints.local else ""
    begins = "; begins when there is a receiver" * waits
    stops = "; Ctrl-C stops" * sys.stderr.isatty()
    sys.stderr.write(f"publishing {', '.join(streams)}{reach}{begins}{stops}\n")


def recordings_of(statuses: list[dict[str, Any]]) -> dict[str, dict[str, Any] | None]:
    """States of recordings by stream."""
    return {f"{status['vehicle']}/{status['sensor']}": status["recording"] for status in statuses}


def tell_of(statuses: list[dict[str, Any]], as_json: bool) -> None:
    """Print what was published, and the folders of recordings.

    Raises SourceError if a recording is not complete.
    """
    recordings = recordings_of(statuses)
    lines = [summary_line(status) for status in statuses]
    lines += [
        f"{name}: recorded, the last file is {one['file']}" for name, one in recordings.items() if one and one["file"]
    ]
    tell({"streams": statuses}, "\n".join(lines), as_json)
    check_recorded(recordings)


def check_loop(source: PacketSource, loop: bool) -> None:
    """Raise SettingsError if a live source is to be repeated."""
    if loop and source.live:
        raise SettingsError(f"{source.label} is live, so it cannot be repeated: leave out --loop", "loop")


def summary_line(status: dict[str, Any]) -> str:
    """Totals of a stream, in one line."""
    rate = "" if status["mean_fps"] is None else f", {status['mean_fps']:.1f} a second,"
    return (
        f"{status['vehicle']}/{status['sensor']}: {counted(status['frames'], 'frame')}{rate} in "
        f"{status['bytes']:,} bytes sent, "
        f"{status['replaced']} replaced, {status['no_receiver']} without a receiver"
        + f", {status['left_out']} left out to keep the target" * bool(status["left_out"])
        + late(status)
        + not_kept(status)
        + too_much(status)
    )


def late(status: dict[str, Any]) -> str:
    """How many packets of a replay or simulator came late; an empty text for none."""
    packets = status["source"].get("late packets", 0)
    return f", {packets} packets late: this machine is too slow for the rate" * bool(packets)


def not_kept(status: dict[str, Any]) -> str:
    """How many frames --keep did not keep, and why; an empty text for none."""
    past = status["past"] or {"counts": {}, "stopped": None}
    late = past["counts"].get("dropped", 0) + past["counts"].get("unwritten", 0)
    frames = late + past["counts"].get("not recorded", 0)
    slow = "the disk, or this processor, is too slow" if late else "the disk did not take them"
    return f", {frames} of {status['assembled']} not kept: {past['stopped'] or slow}" * bool(frames)


def too_much(status: dict[str, Any]) -> str:
    """What to do where most frames were replaced by newer ones; an empty text where few were."""
    if status["frames"] == 0 or status["replaced"] <= status["frames"]:
        return ""
    encoding, sending = (_mean_ms(times) for times in (status["encode_ms"], status["flight"]["arrive_ms"]))
    if encoding > sending:
        slow = f"; most of the time went into encoding, {encoding:.0f} ms a frame"
        return slow + (": choose a quicker codec, or auto" if status["settings"]["codec"] != AUTO else "")
    waits = f"; most of the time went into waiting for the link, {sending:.0f} ms a message: "
    return waits + ("--link 1mbit sends less" if status["settings"]["target_kbps"] is None else "lower target_kbps")


def _mean_ms(times: dict[str, Any]) -> float:
    return float(times["mean"] or 0.0)

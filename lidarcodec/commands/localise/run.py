"""`lidarcodec localise`: tracks a live stream or a source in a map, and says where it is."""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any, Final, TextIO

from lidarcodec.apps.receiver.live_stream import LiveStream
from lidarcodec.commands.convert.frames import frames_of_source
from lidarcodec.commands.endpoints import Given, endpoints_of
from lidarcodec.commands.localise.messages import TUM, pose_json, read_odometry, tum_line
from lidarcodec.commands.localise.progress import Progress
from lidarcodec.commands.running.attending import attended
from lidarcodec.commands.running.stopping import StoppedError, Watched, stoppable
from lidarcodec.commands.running.telling import tell
from lidarcodec.commands.selection.numbers import numbers_of
from lidarcodec.commands.sources import check_finite, check_not_input
from lidarcodec.commands.subscribe import awaited
from lidarcodec.errors import SettingsError, SourceError, TransportError
from lidarcodec.evaluation.rigid import Matrix
from lidarcodec.evaluation.trajectory import scan_of
from lidarcodec.files.whole import Whole, check_free, whole
from lidarcodec.filling import measured_only
from lidarcodec.frame import Frame
from lidarcodec.maps.localise.localiser import Localiser
from lidarcodec.maps.localise.served import served_tiles, served_windows
from lidarcodec.maps.localise.tracker import Estimate
from lidarcodec.maps.localise.window import Windows
from lidarcodec.maps.served.shelf import ENDING
from lidarcodec.maps.served.sources import NetworkTiles, StoppedFetchError
from lidarcodec.settings import is_name
from lidarcodec.sources.spec import parse
from lidarcodec.sources.table import SCHEMES
from lidarcodec.transport import Endpoints, Transport, open_transport, party_of
from lidarcodec.transport.base import Priority, Sender
from lidarcodec.transport.keys import PREFIX, StreamKeys

logger = logging.getLogger(__name__)

ENDINGS: Final = (".pcap", ".pcapng", ".mcap", ".xz", ".zst", ".bin", ".bag", ".db3")
"""Endings of files: a name that ends so is no stream."""
PATIENCE_S: Final = 60.0
"""How long somebody is waited for who serves the map."""
FRESH_NS: Final = 500_000_000
"""Odometry is used for a scan that is at most this much older or younger."""
REMEMBERED: Final = 500
"""Poses of odometry that are kept: 5 s at 100 Hz."""


@dataclass(frozen=True)
class Asked:
    """The options of `localise` for all kinds of streams."""

    stream: str
    town: Path | str
    start: str | None
    out: Path | None
    frames: int | None
    skip: int
    force: bool

    def place(self) -> tuple[float, float, float] | None:
        """`--start` as numbers. Raises SettingsError."""
        if self.start is None:
            return None
        form = "X,Y,YAW in metres and degrees, as in 12.5,-3,90"
        x, y, yaw = numbers_of("--start", self.start, form, 3)
        if max(abs(x), abs(y), abs(yaw)) >= 1e8:
            raise SettingsError(f"--start {self.start}: write {form}", "start")
        return x, y, yaw

    def check(self) -> None:
        """Raise SettingsError if the place or the output cannot be."""
        self.place()
        if self.out is not None:
            if self.out.suffix.lower() != ".txt":
                raise SettingsError(f"the name of a file of poses must end in .txt, not {self.out.name}", "out")
            check_free(self.out, force=self.force)
            if isinstance(self.town, Path):
                check_not_input(self.out, self.town)

    @property
    def map_name(self) -> str:
        """Name of the map: of its file, without the ending, or on the network."""
        return self.town.stem if isinstance(self.town, Path) else self.town


def town_of(text: str) -> Path | str:
    """The file of a map, or the name of one on the network: a name is one without ending, where no file is."""
    return text if is_name(text) and Path(text).suffix.lower() != ENDING and not Path(text).exists() else Path(text)


def key_of(stream: str) -> str | None:
    """The key of a live stream; None if the text names a source."""
    text = stream.removeprefix("zenoh:").removeprefix(f"{PREFIX}/")
    parts = text.split("/")
    if text != stream:
        StreamKeys.parse(text)
        return text
    if len(parts) != 2 or not all(map(is_name, parts)) or parts[1].lower().endswith(ENDINGS) or Path(text).exists():
        return None
    return text


def check_source(until_end: bool, receiver: str | None, given: tuple[Any, ...]) -> None:
    """Raise SettingsError for an option that is only for live streams."""
    names = ("--connect", "--listen", "--zenoh-config", "--until-end", "--receiver")
    for name, value in zip(names, (*given, until_end, receiver), strict=True):
        if value:
            raise SettingsError(
                f"{name} is only for a live stream (VEHICLE/SENSOR): leave it out for a source", name.lstrip("-")
            )


def check_live(calibration: Path | None, model: str | None, skip: int) -> None:
    """Raise SettingsError for an option that is not for live streams."""
    for name, value in (("--calibration", calibration), ("--model", model), ("--skip", skip)):
        if value:
            raise SettingsError(f"{name} is not for a live stream", name.lstrip("-"))


def of_source(asked: Asked, spec: str, calibration: Path | None, as_json: bool) -> None:
    """Track the frames of a file, a socket or a simulated drive."""
    asked.check()
    if isinstance(asked.town, str):
        raise SettingsError(
            f"there is no map file '{asked.town}'. A served map works only with a live stream: `lidarcodec map "
            f"fetch {asked.town}` saves it as a file",
            "map",
        )
    check_finite(spec, asked.frames, live_too=False)
    if asked.out is not None:
        check_not_input(asked.out, spec)
    parsed = parse(spec, SCHEMES)
    with (
        _localiser(asked, background=parsed.scheme in ("udp", "ros2")) as localiser,
        frames_of_source(spec, calibration) as source,
        _poses(asked) as poses,
        stoppable(source.finish if source.live else None) as stopped,
    ):
        progress = Progress(asked.stream, localiser)
        watched = Watched(source, (lambda: False) if source.live else stopped)
        end = None if asked.frames is None else asked.skip + asked.frames
        for frame in islice(watched, asked.skip, end):
            _take(frame, localiser, progress, poses.write)
        source.say()
        if not (progress.poses or source.live or watched.cut):
            raise SourceError(_nowhere(asked, progress.scans, localiser.damaged_tiles))
        if watched.cut and poses.output is not None:
            poses.output.only_part()
    _tell(progress, poses, asked, None, as_json)
    if watched.cut:
        raise StoppedError("stopped: the poses cover only a part of the source")


def _nowhere(asked: Asked, scans: int, damaged_tiles: int) -> str:
    """The message about a source of which no scan was found."""
    if not scans:
        return f"{asked.stream}: it has no scans"
    unread = f" {damaged_tiles} of its tiles cannot be read." if damaged_tiles else ""
    return (
        f"{asked.stream}: no scan of {scans} was found in {asked.map_name}.{unread} Check that the map is of this "
        "place, or give --start X,Y,YAW, where the first scan was taken"
    )


def live(asked: Asked, key: str, receiver: str | None, until_end: bool, given: Given, as_json: bool) -> None:
    """Track a live stream until a signal arrives, `frames` scans have come, or, with `until_end`, it has ended."""
    asked.check()
    endpoints, keys, stop = endpoints_of(given), StreamKeys.parse(key), threading.Event()
    party = party_of(endpoints)
    if party is not None and party.role == "viewer":
        logger.warning(
            "poses reach nobody on the network: %s is a viewer, and only operators may send them", party.name
        )
    summary: dict[str, Any] | None = None
    with (
        stoppable(stop.set) as stopped,
        _served(asked, endpoints, stop) as served,
        _localiser(asked, served, background=True) as localiser,
        _poses(asked) as poses,
    ):
        progress = Progress(f"{keys.vehicle}/{keys.sensor}", localiser)
        try:
            with nullcontext(served.transport) if served else open_transport(endpoints, stop=stop) as transport:
                stream = LiveStream(
                    key, endpoints=endpoints, transport=transport, receiver=receiver, until_end=until_end
                )
                sender = transport.sender(keys.pose(stream.receiver), Priority.STATUS)
                odometry = _Odometry()
                transport.listen(keys.odometry, odometry.came)
                sent = _Sent(sender, asked.map_name, localiser.frame)
                with stream, _interrupting(stream, stop):
                    for frame in islice(awaited(stream, progress.stream), asked.frames):
                        hint = odometry.near(frame.stamp_ns)
                        if hint is not None:
                            localiser.propose(hint)
                        estimates = _take(frame, localiser, progress, poses.write)
                        sent.newest(estimates)
                    summary = stream.summary()
        except TransportError:
            if not stopped():
                raise
    _tell(progress, poses, asked, summary, as_json, served)


def _take(frame: Frame, localiser: Localiser, progress: Progress, write: Callable[[Estimate], None]) -> list[Estimate]:
    begun = progress.begin()
    estimates = localiser.take(scan_of(measured_only(frame)))
    progress.tracked(begun, estimates)
    for estimate in estimates:
        write(estimate)
    return estimates


@dataclass(frozen=True)
class _Served:
    """A map on the network: the session, windows of the map, and where their tiles come from."""

    transport: Transport
    windows: Windows
    source: NetworkTiles


@contextmanager
def _served(asked: Asked, endpoints: Endpoints, stop: threading.Event) -> Iterator[_Served | None]:
    """The map of `--map NAME`; None for a file. Raises TransportError, SourceError, StoppedError after a signal."""
    if isinstance(asked.town, Path):
        yield None
        return
    with open_transport(endpoints, stop=stop) as transport:
        source, place = served_tiles(asked.town, transport, PATIENCE_S), asked.place()
        try:
            attended(source.manifest, source.stop, stop, lambda: f"waits {source.waiting}")
            windows = served_windows(source, place and place[:2], stop)
        except StoppedFetchError:
            raise StoppedError("stopped before the map arrived") from None
        yield _Served(transport, windows, source)


@contextmanager
def _localiser(asked: Asked, served: _Served | None = None, *, background: bool) -> Iterator[Localiser]:
    where = Path(asked.town) if served is None else served.windows
    with Localiser(where, background=background) as localiser:
        place = asked.place()
        if place is not None:
            localiser.start(*place)
        yield localiser


@contextmanager
def _interrupting(stream: LiveStream, stop: threading.Event) -> Iterator[None]:
    """Interrupt the stream when the event is set: a signal handler must take no lock, and knows no stream yet."""
    done = threading.Event()

    def wait() -> None:
        while not done.is_set():
            if stop.wait(0.1):
                stream.interrupt()
                return

    waiting = threading.Thread(target=wait, name="lidarcodec stop", daemon=True)
    waiting.start()
    try:
        yield
    finally:
        done.set()
        waiting.join()


class _Sent:
    """Estimates on the key `pose`. Those of scans that waited for a search are older than what was sent, and stay."""

    def __init__(self, sender: Sender, name: str, frame: str) -> None:
        self._sender, self._name, self._frame = sender, name, frame

    def newest(self, estimates: list[Estimate]) -> None:
        """Send the last estimate."""
        self._sender.put(pose_json(estimates[-1], self._name, self._frame))


class _Odometry:
    """The last poses that the vehicle sent on the key `odometry`: frames come later than they do."""

    def __init__(self) -> None:
        self._last: deque[tuple[int, Matrix]] = deque(maxlen=REMEMBERED)

    def came(self, key: str, data: bytes) -> None:
        """Handler of the key; what is no odometry is dropped."""
        told = read_odometry(data)
        if told is not None:
            self._last.append(told)

    def near(self, stamp_ns: int) -> Matrix | None:
        """The pose of about this time."""
        stamp, pose = min(tuple(self._last), key=lambda told: abs(told[0] - stamp_ns), default=(0, None))
        return pose if abs(stamp - stamp_ns) <= FRESH_NS else None


class _Poses:
    """The file of poses. output: None without `--out`"""

    def __init__(self, output: Whole | None, file: TextIO | None) -> None:
        self.output, self._file = output, file
        self._last_ns: int | None = None
        self._earlier = 0

    def write(self, estimate: Estimate) -> None:
        """Write the pose of an estimate that has one, if it is later than the last."""
        if self._file is None or estimate.pose is None:
            return
        if self._last_ns is None or estimate.stamp_ns > self._last_ns:
            self._file.write(tum_line(estimate.stamp_ns, estimate.pose))
            self._last_ns = estimate.stamp_ns
        else:
            self._earlier += 1

    def say(self) -> None:
        """Warn of poses that are not in the file."""
        if self._earlier:
            logger.warning(
                "%d poses are not in the file, because their times are not later than that of one before: did a clock "
                "jump?", self._earlier,
            )  # fmt: skip


@contextmanager
def _poses(asked: Asked) -> Iterator[_Poses]:
    if asked.out is None:
        yield _Poses(None, None)
        return
    with whole(asked.out, force=asked.force) as output, output.beside.open("w") as file:
        file.write(TUM)
        yield _Poses(output, file)


def _tell(
    progress: Progress,
    poses: _Poses,
    asked: Asked,
    received: dict[str, Any] | None,
    as_json: bool,
    served: _Served | None = None,
) -> None:
    progress.end()
    kept = None if poses.output is None else str(poses.output.kept or asked.out)
    found = {**progress.summary(), "map": str(asked.town), "output": kept, "received": received}
    found["tiles_received"] = found["tile_bytes_received"] = None
    text = progress.line()
    poses.say()
    if served is not None:
        tiles, size = served.source.tiles, served.source.received
        found |= {"tiles_received": tiles, "tile_bytes_received": size}
        text += f", {tiles} tiles of the map in {size:,} bytes received"
    tell(found, text, as_json)

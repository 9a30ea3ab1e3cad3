"""Recordings: starts, keeps within limits, stops, lists and plays them. Belongs to the event loop.

A recording keeps the messages as they come from the vehicle; nothing is decoded for it. The disk is written in a thread
of the recorder, so a slow or full one costs that recording and nothing else.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, TypeVar

from lidarcodec.apps.recorder import BackgroundRecorder
from lidarcodec.errors import SourceError, TransportError
from lidarcodec.transport import Transport
from lidarcodec.transport.keys import StreamKeys
from lidarcodec_server.live.holding import Hold
from lidarcodec_server.live.hub import LiveHub
from lidarcodec_server.live.playback import Playback, PlayRequest
from lidarcodec_server.live.shelf import BusyRecordingError, MissingRecordingError, Recording, Shelf, StorageError

logger = logging.getLogger(__name__)

LOOK_S: Final = 0.5
"""How often limits are looked at: at 10 Hz and 25 Mbit/s a recording may be 2 MB over its limit."""
END_S: Final = 30.0
"""How long the end of a recording or a playback is waited for: a disk may stand still."""
MAX_PLAYING: Final = 4
MAX_RECORDING: Final = 64
_FOREVER_BYTES: Final = 2**62
T = TypeVar("T")


@dataclass(frozen=True)
class Limits:
    """When a recording ends by itself."""

    max_seconds: float = 3600.0
    max_bytes: int = 4 * 2**30


async def _in_time(task: asyncio.Task[T], what: str) -> T:
    """What a task gives, which goes on if that takes too long.

    Raises StorageError then.
    """
    try:
        return await asyncio.wait_for(asyncio.shield(task), END_S)
    except TimeoutError:
        raise StorageError(f"{what} did not end within {END_S:g} s: the disk does not respond") from None


class _Active:
    """A recording that runs. `take` is called in the receiver's thread."""

    def __init__(self, recording: Recording, recorder: BackgroundRecorder, limits: Limits) -> None:
        self.recording, self.recorder, self.limits = recording, recorder, limits
        self.stop = asyncio.Event()
        self.began = time.monotonic()
        self.task: asyncio.Task[Recording] | None = None

    def take(self, data: bytes) -> None:
        """Keep a message."""
        self.recorder.message(data)

    def now(self) -> Recording:
        """As it stands, with what the disk has taken."""
        counts = self.recorder.state()["counts"]
        return replace(self.recording, frames=int(counts.get("frames", 0)), size_bytes=int(counts.get("bytes", 0)))

    def over(self) -> str | None:
        """Why it has to end, if it has to."""
        if (lacking := self._lost()) is not None:
            return lacking
        state = self.recorder.state()
        if time.monotonic() - self.began >= self.limits.max_seconds:
            return f"the limit of {self.limits.max_seconds:g} s was reached"
        if int(state["counts"].get("bytes", 0)) >= self.limits.max_bytes:
            return f"the limit of {self.limits.max_bytes} bytes was reached"
        return None

    def lacking(self) -> str | None:
        """Why messages are missing in it, if any are: the disk refused them or was too slow, or its file was lost."""
        if (lost := self._lost()) is not None:
            return lost
        if dropped := int(self.recorder.state()["counts"].get("dropped", 0)):
            return f"{dropped} messages were not recorded: the disk was too slow"
        return None

    def _lost(self) -> str | None:
        """Why it cannot go on, if it cannot."""
        state = self.recorder.state()
        if state["stopped"] is not None:
            return str(state["stopped"])
        if state["counts"].get("lost files"):
            return "its file was removed, replaced or written over while it was written"
        return None


class Recordings:
    """All recordings of a server.

    limits: of a recording that names none, and the most that one may ask for
    open_transport: gives a transport of its own to a playback, since none receives what it sent itself
    """

    def __init__(
        self, shelf: Shelf, hub: LiveHub, open_transport: Callable[[], Transport], limits: Limits | None = None
    ) -> None:
        self.shelf, self.limits = shelf, limits or Limits()
        self._hub, self._open_transport = hub, open_transport
        self._active: dict[StreamKeys, _Active] = {}
        self._playing: dict[str, Playback] = {}
        self._unwritten: dict[str, Recording] = {}
        self._loop = asyncio.get_running_loop()
        self._disk = ThreadPoolExecutor(4, "lidarcodec shelf")

    async def start(self, keys: StreamKeys, by: str | None = None, limits: Limits | None = None) -> Recording:
        """Record a stream.

        Raises BusyRecordingError if it is recorded already, StorageError.
        """
        if keys in self._active:
            raise BusyRecordingError(
                f"{keys.vehicle}/{keys.sensor} is already being recorded: stop that recording first"
            )
        if len(self._active) >= MAX_RECORDING:
            raise StorageError(f"{MAX_RECORDING} streams are being recorded, which is the limit: stop one first")
        wanted = limits or self.limits
        kept = Limits(min(wanted.max_seconds, self.limits.max_seconds), min(wanted.max_bytes, self.limits.max_bytes))
        recording = await self._in_thread(lambda: self.shelf.create(keys, time.time_ns(), by))
        if keys in self._active:  # somebody else was quicker
            await self._in_thread(lambda: self.shelf.remove(recording.id))
            raise BusyRecordingError(
                f"{keys.vehicle}/{keys.sensor} is already being recorded: stop that recording first"
            )
        # One file each: the limit ends the recording before the recorder would begin another file.
        sizes = {"max_file_bytes": _FOREVER_BYTES, "max_total_bytes": 2 * _FOREVER_BYTES}
        active = _Active(recording, BackgroundRecorder(self.shelf.path(recording.id), keys, None, **sizes), kept)
        self._active[keys] = active
        active.recorder.start()
        active.task = self._loop.create_task(self._keep(keys, active))
        logger.info("%s: recording %s", keys.prefix, recording.id)
        return active.now()

    async def stop(self, keys: StreamKeys) -> Recording:
        """End the recording of a stream. Raises MissingRecordingError, StorageError when that takes too long."""
        active = self._active.get(keys)
        if active is None or active.task is None:
            raise MissingRecordingError(f"{keys.vehicle}/{keys.sensor} is not being recorded")
        active.stop.set()
        return await _in_time(active.task, f"the recording of {keys.vehicle}/{keys.sensor}")

    @property
    def running(self) -> int:
        """How many recordings run."""
        return len(self._active)

    @property
    def played(self) -> int:
        """How many recordings are played."""
        return len(self._playing)

    def of(self, keys: StreamKeys) -> Recording | None:
        """The recording of a stream that runs now."""
        active = self._active.get(keys)
        return None if active is None else active.now()

    def names(self) -> tuple[dict[StreamKeys, str], dict[StreamKeys, str]]:
        """Ids of the recordings that run, by the stream that is recorded, and of those that are played, by the stream
        that they are. From any thread.
        """
        recorded = {keys: active.recording.id for keys, active in self._active.copy().items()}
        requests = {name: playback.request for name, playback in self._playing.copy().items()}
        return recorded, {StreamKeys(one.vehicle, one.sensor): name for name, one in requests.items()}

    async def all(self) -> list[Recording]:
        """Every recording, newest first. Raises StorageError."""
        running = {one.recording.id: one.now() for one in self._active.values()}
        found = await self._in_thread(self.shelf.recordings)
        known = self._unwritten | running
        return [known.get(one.id, one) for one in found]

    async def one(self, name: str) -> Recording:
        """One recording. Raises MissingRecordingError."""
        for active in self._active.values():
            if active.recording.id == name:
                return active.now()
        known = self._unwritten.get(name)
        return known if known is not None else await self._in_thread(lambda: self.shelf.recording(name))

    async def remove(self, name: str) -> None:
        """Delete a recording. Raises MissingRecordingError, BusyRecordingError, StorageError."""
        if name in self._playing or self._runs(name):
            raise BusyRecordingError(f"recording {name} is being recorded or played: stop it first")
        known = self._unwritten.get(name)
        try:
            await self._in_thread(lambda: self.shelf.remove(name))
        except MissingRecordingError:  # its folder is gone already
            if known is None:
                raise
        self._unwritten.pop(name, None)

    async def play(self, name: str, request: PlayRequest) -> dict[str, Any]:
        """Play a recording as a stream of its own; what it is called.

        Raises MissingRecordingError, BusyRecordingError, StorageError, SettingsError, UnknownNameError, SourceError,
        TransportError.
        """
        await self.one(name)
        if self._runs(name):
            raise BusyRecordingError(f"recording {name} is still running: stop it first")
        if name in self._playing:
            raise BusyRecordingError(f"recording {name} is already being played: stop it first")
        if len(self._playing) >= MAX_PLAYING:
            raise BusyRecordingError(f"{MAX_PLAYING} recordings are being played, which is the limit: stop one first")
        wanted = StreamKeys(request.vehicle, request.sensor)
        if wanted in self.names()[1]:  # also one that is about to begin
            raise BusyRecordingError(
                f"a recording is already played as {wanted.vehicle}/{wanted.sensor}: choose another name"
            )
        playback = self._playing[name] = Playback(request)
        try:
            hold = await self._in_thread(lambda: self.shelf.hold(name))
            try:
                file = await self._in_thread(lambda: self.shelf.file(name))
                await self._in_thread(lambda: self._begin(name, file, playback))
            except BaseException:
                hold.close()
                raise
        except BaseException:
            self._playing.pop(name, None)
            raise
        playback.task = self._loop.create_task(self._watch_playback(name, playback, hold))
        logger.info("recording %s is played as %s/%s", name, request.vehicle, request.sensor)
        return playback.state()

    def _begin(self, name: str, file: Path, playback: Playback) -> None:
        """Begin to play a file. Errors name the recording, not where it lies."""
        try:
            playback.start(file, self._open_transport())
        except SourceError as error:
            raise SourceError(str(error).replace(str(file), f"recording {name}")) from None

    async def stop_playing(self, name: str) -> None:
        """End a playback. Raises MissingRecordingError, StorageError when that takes too long."""
        playback = self._playing.get(name)
        if playback is None or playback.task is None:
            raise MissingRecordingError(f"recording {name[:64]} is not being played")
        playback.ended.set()
        await _in_time(playback.task, f"the playback of {name[:64]}")

    def steer(self, name: str, **wanted: Any) -> dict[str, Any]:
        """Hold a playback, or have it go on elsewhere; what it does now. wanted: as `Playback.steer` takes it.

        Raises MissingRecordingError.
        """
        playback = self._playing.get(name)
        if playback is None:
            raise MissingRecordingError(f"recording {name[:64]} is not being played")
        playback.steer(**wanted)
        return playback.state()

    def playing(self, name: str) -> dict[str, Any] | None:
        """What is known of a playback; None if there is none."""
        playback = self._playing.get(name)
        return None if playback is None else playback.state()

    async def close(self) -> None:
        """End all recordings and playbacks."""
        for active in self._active.values():
            active.stop.set()
        for playback in self._playing.values():
            playback.ended.set()
        tasks = [*(one.task for one in self._active.values()), *(one.task for one in self._playing.values())]
        running = [task for task in tasks if task is not None]
        if running:
            _, late = await asyncio.wait(running, timeout=END_S)
            if late:
                logger.warning("%d recordings or playbacks did not end within %g s", len(late), END_S)
        self._disk.shutdown(wait=False)

    # --- tasks ------------------------------------------------------------------------------------------------------

    async def _keep(self, keys: StreamKeys, active: _Active) -> Recording:
        reason: str | None = None
        failed = False
        try:
            async with self._hub.watching(keys, decode=False) as watch:
                watch.tap(active.take)
                try:
                    while reason is None and not active.stop.is_set():
                        with contextlib.suppress(TimeoutError):
                            await asyncio.wait_for(active.stop.wait(), LOOK_S)
                        reason = active.over() or await self._in_thread(self._full)
                finally:
                    watch.untap(active.take)
        except (TransportError, OSError) as error:
            reason, failed = str(error), True
        finally:
            await self._in_thread(active.recorder.close)
            while active.recorder.writing:  # the folder stays held, and nobody is told that it is done
                await self._in_thread(active.recorder.close)
            lacking = active.lacking()
            ended = replace(
                active.now(),
                state="failed" if failed or lacking else "complete",
                reason=lacking or reason,
                ended_ns=time.time_ns(),
            )
            ended = await self._in_thread(lambda: self._write_end(ended))
            self._active.pop(keys, None)
        level = logging.WARNING if ended.state == "failed" else logging.INFO
        logger.log(level, "%s: recording %s ended: %s", keys.prefix, ended.id, ended.reason or "stopped")
        return ended

    async def _watch_playback(self, name: str, playback: Playback, hold: Hold) -> None:
        try:
            while not playback.ended.is_set() and not playback.finished:
                with contextlib.suppress(TimeoutError):
                    await asyncio.wait_for(playback.ended.wait(), LOOK_S)
        finally:
            await self._in_thread(playback.stop)
            hold.close()
            self._playing.pop(name, None)
            logger.info("recording %s is no longer played", name)

    def _runs(self, name: str) -> bool:
        """Whether this server is making a recording."""
        return any(active.recording.id == name for active in self._active.values())

    def _full(self) -> str | None:
        try:
            return self.shelf.full(sum(one.now().size_bytes for one in [*self._active.values()]))
        except (OSError, StorageError) as error:
            return str(error)

    def _write_end(self, ended: Recording) -> Recording:
        ended = self.shelf.sized(ended)
        try:
            self.shelf.note(ended)
        except OSError as error:  # a full disk: it is told until the server ends, and is `interrupted` afterwards
            logger.error("the end of recording %s could not be saved: %s", ended.id, error)  # noqa: TRY400
            self._unwritten[ended.id] = ended
        finally:
            self.shelf.release(ended.id)
            self.shelf.count_again()
        return ended

    async def _in_thread(self, work: Callable[[], T]) -> T:
        return await self._loop.run_in_executor(self._disk, work)

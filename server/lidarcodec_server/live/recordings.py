"""Recordings: starts, limits, stops, lists and plays recordings. Belongs to the event loop.

A recording has the messages as the vehicle sent them; nothing is decoded for it. The recorder writes to the disk in a
thread of its own, so a slow or full disk affects only that recording.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import time
from collections import Counter
from collections.abc import Awaitable, Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, TypeVar

from lidarcodec.apps.recorder import BackgroundRecorder
from lidarcodec.errors import SourceError, TransportError
from lidarcodec.transport import Transport
from lidarcodec.transport.keys import StreamKeys
from lidarcodec_server.live.download import Download
from lidarcodec_server.live.hub import LiveHub
from lidarcodec_server.live.playback import Playback, PlayRequest
from lidarcodec_server.live.running import Limits, RunningRecording
from lidarcodec_server.live.shelf import BusyRecordingError, MissingRecordingError, Recording, Shelf, StorageError

logger = logging.getLogger(__name__)

LOOK_S: Final = 0.5
"""Interval of checks of the limits. At 10 Hz and 25 Mbit/s a recording can exceed its limit by 2 MB."""
END_S: Final = 30.0
"""Longest wait for the end of a recording or a playback, because a disk may not respond."""
ENDS: Final = ("stopped", "limit", "full", "failed")
"""How a recording ended: by a request, at its own limit, for want of room on the disk, or with messages missing."""
MAX_PLAYING: Final = 4
MAX_RECORDING: Final = 64
_FOREVER_BYTES: Final = 2**62
T = TypeVar("T")
Borrow = Callable[[], Awaitable[tuple[Path, Callable[[], object]]]]
"""Gives a file to play, and what to call when it is no longer read."""


async def _in_time(task: asyncio.Task[T], what: str) -> T:
    """Wait for the result of a task.

    Raises StorageError if it takes too long; the task continues.
    """
    try:
        return await asyncio.wait_for(asyncio.shield(task), END_S)
    except TimeoutError:
        raise StorageError(f"{what} did not end within {END_S:g} s: the disk does not respond") from None


class Recordings:
    """All recordings of a server.

    limits: default limits of a recording, and the largest allowed ones
    ends: how many recordings ended in which way of `ENDS`
    open_transport: opens a transport for a playback, because a transport does not receive its own messages
    """

    def __init__(
        self, shelf: Shelf, hub: LiveHub, open_transport: Callable[[], Transport], limits: Limits | None = None
    ) -> None:
        self.shelf, self.limits = shelf, limits or Limits()
        self._hub, self._open_transport = hub, open_transport
        self._active: dict[StreamKeys, RunningRecording] = {}
        self._playing: dict[str, Playback] = {}
        self._unwritten: dict[str, Recording] = {}
        self.ends: Counter[str] = Counter()
        self._loop = asyncio.get_running_loop()
        self._disk = ThreadPoolExecutor(4, "lidarcodec shelf")

    async def start(self, keys: StreamKeys, by: str | None = None, limits: Limits | None = None) -> Recording:
        """Record a stream.

        Raises BusyRecordingError if it is already being recorded, StorageError.
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
        if keys in self._active:  # another request was quicker
            await self._in_thread(lambda: self.shelf.remove(recording.id))
            raise BusyRecordingError(
                f"{keys.vehicle}/{keys.sensor} is already being recorded: stop that recording first"
            )
        # One file for each recording: the limit ends it before the recorder would begin a second file.
        sizes = {"max_file_bytes": _FOREVER_BYTES, "max_total_bytes": 2 * _FOREVER_BYTES}
        recorder = BackgroundRecorder(self.shelf.path(recording.id), keys, None, None, **sizes)
        active = RunningRecording(recording, recorder, kept)
        self._active[keys] = active
        active.recorder.start()
        active.task = self._loop.create_task(self._keep(keys, active))
        logger.info("%s: recording %s", keys.prefix, recording.id)
        return active.now()

    async def stop(self, keys: StreamKeys) -> Recording:
        """End the recording of a stream. Raises MissingRecordingError, StorageError if that takes too long."""
        active = self._active.get(keys)
        if active is None or active.task is None:
            raise MissingRecordingError(f"{keys.vehicle}/{keys.sensor} is not being recorded")
        active.stop.set()
        return await _in_time(active.task, f"the recording of {keys.vehicle}/{keys.sensor}")

    @property
    def running(self) -> int:
        """Number of running recordings."""
        return len(self._active)

    @property
    def played(self) -> int:
        """Number of playbacks."""
        return len(self._playing)

    def of(self, keys: StreamKeys) -> Recording | None:
        """The running recording of a stream; None if there is none."""
        active = self._active.get(keys)
        return None if active is None else active.now()

    def names(self) -> tuple[dict[StreamKeys, str], dict[StreamKeys, str]]:
        """Ids of the running recordings, by recorded stream, and of the played recordings, by the stream of the
        playback.
        From any thread.
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
        except MissingRecordingError:  # its folder was already deleted
            if known is None:
                raise
        self._unwritten.pop(name, None)

    async def download(self, name: str, ended: Callable[[], object]) -> Download:
        """The answer with the bytes of a recording, which cannot be deleted before `ended` is called.

        Raises MissingRecordingError, BusyRecordingError while it is being recorded, StorageError. Then `ended` is not
        called.
        """
        recording = await self.one(name)
        if recording.state == "recording":
            raise BusyRecordingError(f"recording {name} is still running: stop it first")
        hold = await self._in_thread(lambda: self.shelf.hold(name))

        def over() -> None:
            hold.close()
            ended()

        try:
            file = await self._in_thread(lambda: self.shelf.file(name))
            title = f"{recording.vehicle}_{recording.sensor}_{recording.id}.mcap"
            return await self._in_thread(lambda: Download(file, title, over))
        except BaseException:
            hold.close()
            raise

    async def play(self, name: str, request: PlayRequest) -> dict[str, Any]:
        """Play a recording as a stream of its own. Returns the state of the playback.

        Raises MissingRecordingError, BusyRecordingError, StorageError, SettingsError, UnknownNameError, SourceError,
        TransportError.
        """
        await self.one(name)
        if self._runs(name):
            raise BusyRecordingError(f"recording {name} is still running: stop it first")
        return await self.play_file(name, request, lambda: self._borrow(name))

    async def _borrow(self, name: str) -> tuple[Path, Callable[[], object]]:
        hold = await self._in_thread(lambda: self.shelf.hold(name))
        try:
            return await self._in_thread(lambda: self.shelf.file(name)), hold.close
        except BaseException:
            hold.close()
            raise

    async def play_file(self, name: str, request: PlayRequest, borrow: Borrow) -> dict[str, Any]:
        """Play a file as a stream of its own; `stop_playing` and `steer` know it by its name. Raises as `play`.

        borrow: gives the file, and what to call when it is no longer read. It is asked only while there is a place
        """
        if name in self._playing:
            raise BusyRecordingError(f"recording {name} is already being played: stop it first")
        if len(self._playing) >= MAX_PLAYING:
            raise BusyRecordingError(f"{MAX_PLAYING} recordings are being played, which is the limit: stop one first")
        wanted = StreamKeys(request.vehicle, request.sensor)
        if wanted in self.names()[1]:  # including playbacks that are about to begin
            raise BusyRecordingError(
                f"a recording is already played as {wanted.vehicle}/{wanted.sensor}: choose another name"
            )
        playback = self._playing[name] = Playback(request)
        try:
            file, give_back = await borrow()
            try:
                await self._in_thread(lambda: self._begin(name, file, playback))
            except BaseException:
                give_back()
                raise
        except BaseException:
            self._playing.pop(name, None)
            raise
        playback.task = self._loop.create_task(self._watch_playback(name, playback, give_back))
        logger.info("recording %s is played as %s/%s", name, request.vehicle, request.sensor)
        return playback.state()

    def _begin(self, name: str, file: Path, playback: Playback) -> None:
        """Begin to play a file. Errors name the recording, not its path."""
        try:
            playback.start(file, self._open_transport())
        except SourceError as error:
            raise SourceError(str(error).replace(str(file), f"recording {name}")) from None

    async def stop_playing(self, name: str) -> None:
        """End a playback. Raises MissingRecordingError, StorageError if that takes too long."""
        playback = self._playing.get(name)
        if playback is None or playback.task is None:
            raise MissingRecordingError(f"recording {name[:64]} is not being played")
        playback.ended.set()
        await _in_time(playback.task, f"the playback of {name[:64]}")

    def steer(self, name: str, **wanted: Any) -> dict[str, Any]:
        """Pause, move or change a playback. Returns its state. wanted: arguments of `Playback.steer`

        Raises MissingRecordingError.
        """
        playback = self._playing.get(name)
        if playback is None:
            raise MissingRecordingError(f"recording {name[:64]} is not being played")
        playback.steer(**wanted)
        return playback.state()

    def playing(self, name: str) -> dict[str, Any] | None:
        """The state of a playback; None if there is none."""
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

    async def _keep(self, keys: StreamKeys, active: RunningRecording) -> Recording:
        reason: str | None = None
        full: str | None = None
        failed = False
        try:
            async with self._hub.watching(keys, decode=False) as watch:
                watch.tap(active.take)
                try:
                    while reason is None and not active.stop.is_set():
                        with contextlib.suppress(TimeoutError):
                            await asyncio.wait_for(active.stop.wait(), LOOK_S)
                        reason = active.over() or (full := await self._in_thread(self._full))
                finally:
                    watch.untap(active.take)
        except (TransportError, OSError) as error:
            reason, failed = str(error), True
        finally:
            await self._in_thread(active.recorder.close)
            while active.recorder.writing:  # until then the folder stays locked, and the recording counts as running
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
        how = "failed" if ended.state == "failed" else "full" if full else "limit" if reason else "stopped"
        self.ends[how] += 1
        level = logging.WARNING if ended.state == "failed" else logging.INFO
        logger.log(level, "%s: recording %s ended: %s", keys.prefix, ended.id, ended.reason or "stopped")
        return ended

    async def _watch_playback(self, name: str, playback: Playback, give_back: Callable[[], object]) -> None:
        try:
            while not playback.ended.is_set() and not playback.finished:
                with contextlib.suppress(TimeoutError):
                    await asyncio.wait_for(playback.ended.wait(), LOOK_S)
        finally:
            await self._in_thread(playback.stop)
            give_back()
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
        except OSError as error:  # a full disk: the end is kept in memory; after a restart it is `interrupted`
            logger.error("the end of recording %s could not be saved: %s", ended.id, error)  # noqa: TRY400
            self._unwritten[ended.id] = ended
        finally:
            self.shelf.release(ended.id)
            self.shelf.count_again()
        return ended

    async def _in_thread(self, work: Callable[[], T]) -> T:
        return await self._loop.run_in_executor(self._disk, work)

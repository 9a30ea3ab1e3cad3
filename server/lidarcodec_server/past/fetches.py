"""Fetches: gets clips from vehicles in the background, a few at a time and one of each vehicle.

A fetch that was running when the server ended goes on when it starts again. A fetch waits for a vehicle that is away
for a day; meanwhile others have their turn.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Final

from lidarcodec.apps.past.clip import Written, write_clip
from lidarcodec.apps.past.fetch import CancelledError, Fetch, SilentError, TurnOverError
from lidarcodec.apps.past.plan import Clip, Plan
from lidarcodec.errors import LidarCodecError, SourceError, told
from lidarcodec.files.whole import written_whole
from lidarcodec.transport import Transport
from lidarcodec_server.past.clips import Clips, Record, few, largest_vehicles_first, oldest_first

logger = logging.getLogger(__name__)

RUNNING: Final = 4
"""Most fetches at once."""
MAX_WAITING: Final = 64
OF_MARK: Final = "mark "
MAX_OF_MARKS, MAX_OF_VEHICLE = 48, 8
"""Most fetches of marks that wait, of all vehicles and of one: the others are for people, and for other vehicles."""
MAX_ENDED: Final = 1000
"""Most fetches that ended and are remembered; the oldest without a clip are forgotten."""
TURN_S: Final = 20.0
"""After so long without an answer of its vehicle, a fetch lets others have its turn."""
LONGEST_TURN_S: Final = 120.0
"""After so long a fetch lets others have their turn, though pieces still arrive: some links are slow, and some vehicles
send slowly on purpose. A fetch that gets nothing new ends earlier."""
AGAIN_S: Final = 5.0
GIVE_UP_S: Final = 24 * 3600.0
CLOSE_S: Final = 6.0
CLAIM_S: Final = 1.0
"""How often a folder is tried that another server has."""


class NoFetchError(LidarCodecError):
    """There is no such fetch."""


class BusyClipError(LidarCodecError):
    """The clip is being played or downloaded."""


class TooManyFetchesError(LidarCodecError):
    """Too many fetches wait already."""


class _Job:
    """A fetch that is not over."""

    def __init__(self, record: Record, fetch: Fetch) -> None:
        self.record, self.fetch = record, fetch
        self.due_s = self.began_s = 0.0
        self.moved_s = time.monotonic()
        self.running = self.cancelled = False


class Fetches:
    """All fetches of a server. Thread-safe.

    transport: gives the network session, or raises TransportError while there is none
    """

    def __init__(self, clips: Clips, transport: Callable[[], Transport]) -> None:
        self._clips, self._transport = clips, transport
        self._jobs: dict[str, _Job] = {}
        self._ended: dict[str, Record] = {}
        self._read: Counter[str] = Counter()
        self._wake = threading.Condition()
        self._beginning, self._disk = threading.Lock(), threading.Lock()
        self._claiming, self._claimed = threading.Lock(), False
        self._writing = threading.Lock()
        """For changes of a record that must be on the disk in the order in which they were made."""
        self._stopped = False
        self._threads = [
            threading.Thread(target=self._work, name=f"lidarcodec fetch {number}", daemon=True)
            for number in range(RUNNING)
        ]

    def start(self) -> None:
        """Read the folder, and go on with what was not over. While another server has it, nothing is fetched."""
        try:
            self._claim()
        except SourceError as error:
            logger.warning("nothing can be fetched from vehicles: %s", error)
        for thread in self._threads:
            thread.start()

    def _claim(self) -> None:
        """Have the folder, and read it. Raises SourceError while another server has it."""
        with self._claiming:
            if not self._claimed:
                self._clips.claim()
                self._read_folder()
                self._claimed = True

    def _read_folder(self) -> None:
        try:
            for record in map(self._clips.with_clip, self._clips.records()):
                if record.state == "running":
                    self._jobs[record.id] = self._job(record)
                else:
                    self._ended[record.id] = record
        except SourceError as error:
            logger.warning("the list of earlier fetches cannot be read: %s", error)

    def close(self) -> None:
        """Stop; what is not over goes on after the next start. A second call does nothing."""
        with self._wake:
            self._stopped = True
            for job in self._jobs.values():
                job.fetch.cancel()
            self._wake.notify_all()
        end = time.monotonic() + CLOSE_S
        for thread in self._threads:
            if thread.is_alive():
                thread.join(max(0.0, end - time.monotonic()))
        self._clips.give_back()

    def here(self, clip: Clip) -> Record | None:
        """The fetch that brought a clip that is here; None if it is not."""
        with self._wake:
            done = [one for one in self._ended.values() if one.state == "complete" and one.clip == clip]
        return next((one for one in reversed(done) if self._clips.clip_file(one).is_file()), None)

    def borrow(self, record: Record) -> tuple[Path, Callable[[], None]]:
        """The file of a clip, and what to call once when it is no longer read. Until then it is not deleted.

        Raises NoFetchError if it is not here.
        """
        with self._wake:
            found = self._ended.get(record.id)
            if found is None or found.state != "complete":
                raise NoFetchError("the server does not have this clip: fetch it first")
            self._read[record.id] += 1
        path = self._clips.clip_file(record)

        def give_back() -> None:
            with self._wake:
                self._read -= Counter([record.id])

        if not path.is_file():
            give_back()
            raise NoFetchError("the server no longer has this clip: fetch it again")
        return path, give_back

    def running(self, clip: Clip) -> Record | None:
        """The fetch of this very clip that goes on, and was not cancelled; None if there is none."""
        with self._wake:
            return None if (job := self._going(clip)) is None else job.record

    def _going(self, clip: Clip) -> _Job | None:
        """The same, with the lock held."""
        return next((job for job in self._jobs.values() if job.record.clip == clip and not job.cancelled), None)

    def begin(self, clip: Clip, by: str, *, stays: bool = False) -> Record:
        """Fetch a clip, unless it is being fetched already.

        stays: whether the clip is not deleted to make room;  by: begins with OF_MARK if a vehicle told of it, and
        nobody asked
        Raises TooManyFetchesError, SourceError if the folder cannot be written, or another server has it.
        """
        self._claim()
        with self._beginning:
            found = self.running(clip)
            if found is not None:
                return (self.keep(clip) or found) if stays else found
            if len(self._jobs) >= MAX_WAITING:
                raise TooManyFetchesError(f"{MAX_WAITING} fetches are waiting, which is the limit: cancel one first")
            if by.startswith(OF_MARK):
                self._check_places(clip)
            record = self._clips.create(clip, by, time.time_ns(), stays=stays)
            with self._wake:
                self._jobs[record.id] = self._job(record)
                self._wake.notify()
        logger.info("%s: fetching %s for %s", clip.keys.prefix, record.id, by)
        return record

    def _check_places(self, clip: Clip) -> None:
        """Raises TooManyFetchesError if vehicles, or this one, have all places that are for what they tell of."""
        with self._wake:
            of_marks = [job.record for job in self._jobs.values() if job.record.by.startswith(OF_MARK)]
            vehicles = [record.clip.keys.vehicle for record in of_marks]
        if len(vehicles) >= MAX_OF_MARKS or vehicles.count(clip.keys.vehicle) >= MAX_OF_VEHICLE:
            raise TooManyFetchesError("too many clips of marks are waiting already")

    def keep(self, clip: Clip) -> Record | None:
        """Never delete a clip to make room, whether it is here or on its way. Returns its fetch, None if there is none.

        Raises SourceError if that cannot be stored.
        """
        with self._writing:
            with self._wake:
                job = self._going(clip)
                done = [one for one in self._ended.values() if one.state == "complete" and one.clip == clip]
                found = job.record if job is not None else done[-1] if done else None
                if found is None or found.stays:
                    return found
                found = replace(found, stays=True)
                if job is not None:
                    job.record = found
                else:
                    self._ended[found.id] = found
            self._clips.write(found)
        return found

    def cancel(self, name: str) -> Record:
        """End a fetch; if it is complete, delete its clip. Raises NoFetchError, BusyClipError, SourceError."""
        with self._wake:
            job, ended = self._jobs.get(name), self._ended.get(name)
            if job is not None:
                job.cancelled = True
                job.fetch.cancel()
                if not job.running:
                    self._jobs.pop(name)
                self._wake.notify_all()
        if job is not None:
            return job.record if job.running else self._end(job, "cancelled", None)
        if ended is None:
            raise NoFetchError(f"there is no fetch {name[:64]}")
        if not self._forget(ended):
            raise BusyClipError(f"the clip of fetch {name} is being played or downloaded: stop that first")
        self._clips.remove(ended)
        return replace(ended, state="cancelled")

    def state(self, name: str) -> tuple[Record, dict[str, Any] | None]:
        """A fetch, and its progress while it is not over. Raises NoFetchError."""
        with self._wake:
            job, ended = self._jobs.get(name), self._ended.get(name)
        if job is not None:
            return job.record, job.fetch.state()
        if ended is None:
            raise NoFetchError(f"there is no fetch {name[:64]}")
        return ended, None

    def all(self) -> list[Record]:
        """Every fetch, newest first."""
        with self._wake:
            found = [*self._ended.values(), *(job.record for job in self._jobs.values())]
        return sorted(found, key=lambda one: (one.started_ns, one.id), reverse=True)

    # --- the threads ------------------------------------------------------------------------------------------------

    def _job(self, record: Record) -> _Job:
        clips = self._clips

        def turn_over() -> bool:
            return self._turn_over(job)

        fetch = Fetch(record.clip, clips.store, clips.plan_file(record), self._transport, TURN_S, turn_over)
        job = _Job(record, fetch)
        return job

    def _turn_over(self, job: _Job) -> bool:
        """Whether a fetch has had its turn, and another one waits for it."""
        now = time.monotonic()
        if now - job.began_s < LONGEST_TURN_S:
            return False
        with self._wake:
            running = [one for one in self._jobs.values() if one.running]
            busy = {one.record.clip.keys.vehicle for one in running if one is not job}
            others = [one for one in self._jobs.values() if not one.running and one.due_s <= now]
        return any(one.record.clip.keys.vehicle not in busy for one in others)

    def _work(self) -> None:
        while not self._claimed and not self._stopped:
            time.sleep(CLAIM_S)
            with suppress(SourceError):
                self._claim()
        while (job := self._next()) is not None:
            try:
                self._run(job)
            except Exception as error:
                logger.exception("fetch %s failed", job.record.id)
                self._end(job, "failed", f"unexpected error: {type(error).__name__}")
            finally:
                with self._wake:
                    job.running = False
                    self._wake.notify_all()

    def _next(self) -> _Job | None:
        """The next fetch whose turn it is. Waits for one; None at the end."""
        with self._wake:
            while not self._stopped:
                now = time.monotonic()
                busy = {job.record.clip.keys.vehicle for job in self._jobs.values() if job.running}
                waiting = [
                    job for job in self._jobs.values()
                    if not job.running and job.due_s <= now and job.record.clip.keys.vehicle not in busy
                ]  # fmt: skip
                if waiting:
                    job = min(waiting, key=lambda one: (one.due_s, one.record.started_ns))
                    job.running, job.began_s = True, now
                    return job
                self._wake.wait(1.0)
            return None

    def _run(self, job: _Job) -> None:
        before = job.fetch.received
        try:
            plan = job.fetch.run(partial(self._prepare, job))
            with self._disk:
                written = self._assemble(job, plan)
            self._end(job, "complete", None, written.bytes, few(plan.gaps()), written.missing)
        except CancelledError:
            if job.cancelled:
                self._end(job, "cancelled", None)
        except TurnOverError:
            job.due_s = job.moved_s = time.monotonic()
        except SilentError as error:
            now = time.monotonic()
            job.due_s = now + AGAIN_S
            if job.fetch.received > before:
                job.moved_s = now
            if now - job.moved_s > GIVE_UP_S:
                self._end(job, "failed", str(error))
        except LidarCodecError as error:
            self._end(job, "failed", str(error))
        except BaseException as error:  # a panic of native code is not an Exception
            self._end(job, "failed", str(told(error)))

    def _prepare(self, job: _Job, plan: Plan) -> None:
        """The pieces of a clip are known: make room, and take what is here already."""
        with self._disk:
            with self._wake:
                done = [record for record in self._ended.values() if record.state == "complete"]
                plans = [job.fetch.plan for job in self._jobs.values() if job.running]
            self._clips.check_share(job.record, plan, done)
            self._clips.take_from_clips(plan, done)
            others = [one for one in plans if one is not plan and one.listed]
            first = oldest_first
            if job.record.by.startswith(OF_MARK):
                first = partial(largest_vehicles_first, job.record.clip.keys.vehicle, plan, done)
            self._clips.make_room([plan, *others], done, self._gives_way, first)

    def _gives_way(self, record: Record) -> bool:
        """Forget a fetch whose clip is to make room, unless somebody wants to keep the clip by now."""
        with self._wake:
            now = self._ended.get(record.id)
            return now is not None and not now.stays and self._forget(record)

    def _forget(self, record: Record) -> bool:
        """Forget a fetch that is over, unless its clip is being read. Returns whether it may be deleted now."""
        with self._wake:
            if self._read[record.id]:
                return False
            self._ended.pop(record.id, None)
            return True

    def _assemble(self, job: _Job, plan: Plan) -> Written:
        path = self._clips.clip_file(job.record)
        try:
            with written_whole(path, private=True) as beside:
                return write_clip(plan, self._clips.store, beside)
        except OSError as error:
            raise SourceError(f"the clip cannot be written: {error.strerror or error}") from None

    def _end(
        self, job: _Job, state: Any, reason: str | None, size: int = 0, gaps: Any = (), missing: int | None = None
    ) -> Record:
        with self._writing:
            with self._wake:
                if job.cancelled and state == "complete":  # while the clip was written
                    state, size, gaps, missing = "cancelled", 0, (), None
                over = {"state": state, "reason": reason, "size": size, "gaps": gaps, "missing": missing}
                record = replace(job.record, **over, ended_ns=time.time_ns())
                self._jobs.pop(record.id, None)
                self._ended[record.id] = record
                others = [one.fetch.plan for one in self._jobs.values()]
                surplus = [one for one in self._ended.values() if one.state != "complete"]
                surplus = surplus[: max(0, len(self._ended) - MAX_ENDED)]
                for one in surplus:
                    self._ended.pop(one.id, None)
            try:
                self._clips.write(record)
            except SourceError as error:
                logger.warning("fetch %s is %s, but this could not be stored: %s", record.id, state, error)
        if state != "complete":
            with suppress(OSError):
                self._clips.clip_file(record).unlink()
        with self._disk:
            self._clips.forget_pieces(job.fetch.plan, others)
        for one in surplus:
            self._clips.remove(one)
        logger.info("%s: fetch %s: %s", record.clip.keys.prefix, record.id, reason or state)
        return record

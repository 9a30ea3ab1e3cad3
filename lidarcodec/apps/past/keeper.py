"""Keeper: keeps the last hours of a sensor exactly, in a ring of files, in its own thread.

Frames are coded without loss, so that their packets come back byte for byte. A frame never waits for the keeper: if the
disk or the processor is too slow, the oldest waiting frames are dropped and counted. What was written is passed to the
operating system at once, so a kill loses at most the frame that is being written; twice a second it is forced onto the
disk, so a power failure loses at most the last second.
"""

from __future__ import annotations

import logging
import re
import threading
import time
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from lidarcodec.apps.once import Once
from lidarcodec.apps.past.conditions import MAX_CONDITIONS, conditions_of
from lidarcodec.apps.past.kept import Kept
from lidarcodec.apps.recorder import CLOSE_LIMIT_S, LOSSLESS, WAITING, Record
from lidarcodec.errors import LidarCodecError, SettingsError
from lidarcodec.frame import Frame
from lidarcodec.pipeline import StreamEncoder
from lidarcodec.recording import RotatingRecorder
from lidarcodec.recording.marks import Mark
from lidarcodec.transport.keys import StreamKeys
from lidarcodec.wire import pack

logger = logging.getLogger(__name__)

MIN_BYTES, MAX_BYTES = 8 * 2**20, 10**15
MIN_FILE_BYTES, MAX_FILE_BYTES = 2**20, 32 * 2**20
KEY_S: Final = 1.0
"""Interval of key messages. A piece of this length is the smallest part that can be fetched."""
SYNC_S: Final = 0.5
LOOK_S: Final = 5.0
"""Interval at which the totals for the status are counted."""
LOOK_SHARE: Final = 0.005
"""Largest share of the time that counting takes: with many files the interval grows."""
WATCH_S: Final = 1.0
"""Interval at which conditions are looked at."""
MARK_NS: Final = 15 * 10**9
"""A condition marks so much before and after the moment at which it came true."""
BY_STATUS: Final = "status"
"""Maker of the marks of a condition."""
UNMARKED_NS: Final = 600 * 10**9
"""So long it is tried to mark an event that could not be marked, as on a full disk."""
AGAIN_S: Final = 30.0
"""After an error of the disk, interval of attempts to keep again."""
_SIZE: Final = re.compile(r"(\d{1,15}(?:\.\d{1,9})?)\s*([kMGT]?)(i?)B", re.IGNORECASE)


def bytes_of(text: str) -> int:
    """A size such as `64GB`, `500MB` or `2GiB` in bytes.

    Raises SettingsError.

    >>> bytes_of("64GB"), bytes_of("16 MiB")
    (64000000000, 16777216)
    """
    found = _SIZE.fullmatch(text.strip())
    size = 0.0
    if found is not None:
        number, letter, binary = found.groups()
        size = float(number) * (1024 if binary else 1000) ** " kmgt".index(letter.lower() or " ")
    if not MIN_BYTES <= size <= MAX_BYTES:
        raise SettingsError(f"'{text}' is not a size: write for example 64GB, from 8MiB to 1000TB", "keep")
    return int(size)


@dataclass(frozen=True)
class Keep:
    """How much of a sensor is kept, and where.

    max_bytes: size of its files, marked ones among them
    mark_when: conditions on the status that mark the time around them (`conditions.Condition`)
    """

    folder: Path
    max_bytes: int
    mark_when: tuple[str, ...] = ()


def check_apart(record: Record | None, keep: Keep | None) -> None:
    """Raise SettingsError if a recorder and a keeper have one folder."""
    if record is not None and keep is not None and record.folder.resolve() == keep.folder.resolve():
        raise SettingsError("--record and --keep need different folders, because each deletes its oldest files", "keep")


class Keeper:
    """Keeps offered frames. `kept` answers questions about them. Thread-safe.

    status: gives the status that conditions are about;  once: counts and logs errors
    counts: `dropped` (disk or processor too slow), `errors`, `unwritten` (frames that still waited at `close`), and the
            counts of the RotatingRecorder, among them `deleted for a full disk`
    """

    def __init__(self, keep: Keep, keys: StreamKeys) -> None:
        """Raises SettingsError for a size that is too small, and for invalid conditions."""
        if keep.max_bytes < MIN_BYTES:
            raise SettingsError(f"keep at least {MIN_BYTES} bytes, not {keep.max_bytes}", "keep")
        self.keep, self.keys = keep, keys
        self.status: Callable[[], dict[str, Any]] = dict
        self._conditions = conditions_of(keep.mark_when)
        self._unmarked: deque[Mark] = deque(maxlen=MAX_CONDITIONS)
        self.kept = Kept(keep.folder, keys, keep.max_bytes)
        self._files = self._recorder()
        self._queue: deque[Frame] = deque()
        self._condition = threading.Condition()
        self._closed = False
        self.once = Once(logger)
        self._earlier: Counter[str] = Counter()
        self._encoder: StreamEncoder | None = None
        self._key_ns: int | None = None
        self._look_s = LOOK_S
        self._synced_s = self._looked_s = self._watched_s = float("-inf")
        self._thread = threading.Thread(target=self._run, name="lidarcodec keeper", daemon=True)

    def start(self) -> None:
        """Begin to keep."""
        self._thread.start()

    def frame(self, frame: Frame) -> None:
        """Keep a frame. Never waits."""
        with self._condition:
            if self._closed:
                return
            full = len(self._queue) >= WAITING
            if full:
                self._queue.popleft()
                self.once.counts["dropped"] += 1
            first = full and self.once.counts["dropped"] == 1
            self._queue.append(frame)
            self._condition.notify()
        if first:
            logger.warning(
                "%s/%s: --keep does not keep every frame, because the disk or the processor is too slow "
                "(more are only counted, as `dropped` in the status)", self.keys.vehicle, self.keys.sensor,
            )  # fmt: skip

    def state(self) -> dict[str, Any]:
        """For the status: what is kept (docs/live.md lists the fields)."""
        counts = Counter[str]()
        for one in (self._earlier, self._files.counts, self.once.counts):
            counts.update(dict(one))  # in one step: the keeper's thread counts meanwhile
        return {"max_bytes": self.keep.max_bytes, "stopped": self._files.stopped, "counts": dict(counts)} | (
            self.kept.totals
        )

    def close(self) -> None:
        """Write waiting frames for at most CLOSE_LIMIT_S, and end the file. A second call does nothing."""
        with self._condition:
            self._closed = True
            self._condition.notify()
        if self._thread.is_alive():
            self._thread.join(CLOSE_LIMIT_S)
        if self._thread.is_alive():
            with self._condition:
                self.once.counts["unwritten"] = len(self._queue) + 1
            logger.error("--keep: the last frames could not be written within %g s", CLOSE_LIMIT_S)

    def _recorder(self) -> RotatingRecorder:
        size = max(MIN_FILE_BYTES, min(MAX_FILE_BYTES, self.keep.max_bytes // 64))
        files = RotatingRecorder(
            self.keep.folder,
            self.keys.vehicle,
            self.keys.sensor,
            LOSSLESS,
            max_file_bytes=size,
            max_total_bytes=self.keep.max_bytes,
        )
        files.thins, files.stays = True, self.kept.stays
        return files

    def _run(self) -> None:
        stopped_s: float | None = None
        try:
            while True:
                with self._condition:
                    self._condition.wait_for(lambda: bool(self._queue) or self._closed, SYNC_S)
                    frame = self._queue.popleft() if self._queue else None
                    if frame is None and self._closed:
                        return
                now = time.monotonic()
                if self._files.stopped is None:
                    stopped_s = None
                elif stopped_s is None:
                    stopped_s = now
                elif now - stopped_s >= AGAIN_S:
                    stopped_s = None
                    self._earlier.update(self._files.counts)
                    self._files.close()
                    self._files = self._recorder()
                try:
                    if frame is not None:
                        self._write(frame)
                    self._look_after(now)
                except LidarCodecError as error:
                    self.once.add("errors", error)
                except Exception as error:  # an error in this program loses only this frame
                    logger.exception("unexpected error while writing kept data")
                    self.once.add("errors", error)
        finally:
            self.kept.growing = None
            self._files.close()

    def _write(self, frame: Frame) -> None:
        if self._encoder is None:
            self._encoder = StreamEncoder(LOSSLESS)
        due = self._key_ns is None or not 0 <= frame.stamp_ns - self._key_ns < KEY_S * 1e9
        for message in self._encoder.encode(frame, key=due or self._files.waits_for_key):
            if message.key:
                self._key_ns = message.stamp_ns
            self._files.write(pack(message))
            self.kept.growing = self._files.path

    def _watch(self) -> None:
        """Mark the time around each condition that came true. Raises SettingsError, SourceError if it cannot; it is
        tried again then."""
        status = self.status()
        came = [condition.text for condition in self._conditions if condition.came(status)]
        at_ns = time.time_ns()
        from_ns = {text: begin for text in came if (begin := self._unmarked_from(text, at_ns)) is not None}
        if from_ns:
            reason, begin = next(iter(from_ns.items()))
            mark = Mark(f"status-{at_ns}", begin, begin + 2 * MARK_NS, reason, BY_STATUS, at_ns)
            self._unmarked.append(mark)
            error = self._mark()
            if error is not None:
                raise error

    def _unmarked_from(self, reason: str, at_ns: int) -> int | None:
        """Where the mark of an event begins; None if marks of its condition have all of it.

        What they have of it is not marked again: a condition that becomes true and false all the time takes a mark for
        each clip, not for each time.
        """
        from_ns = at_ns - MARK_NS
        marks = [*self._marks_of(reason), *(one for one in self._unmarked if one.reason == reason)]
        for one in sorted(marks, key=lambda one: one.from_ns):
            if one.from_ns <= from_ns < one.to_ns:
                from_ns = one.to_ns
        return from_ns if from_ns < at_ns + MARK_NS else None

    def _mark(self) -> LidarCodecError | None:
        """Mark the events that are not marked yet; the newest error, if any cannot be."""
        found: LidarCodecError | None = None
        for mark in tuple(self._unmarked):
            try:
                released = self.kept.mark(mark, own=True, instead_of=self._marks_of(mark.reason))
            except LidarCodecError as error:
                found = error
                if abs(time.time_ns() - mark.at_ns) <= UNMARKED_NS:
                    continue
            else:
                logger.info("%s: marked, because %s", self.keys.prefix, mark.reason)
                if released:
                    self._say_released(mark, released)
            self._unmarked.remove(mark)
        return found

    def _say_released(self, mark: Mark, count: int) -> None:
        first = not self.once.counts["marks released"]
        self.once.counts["marks released"] += count
        if first:
            logger.warning(
                "%s: there is no room for all marks of '%s', so the newest take the place of the oldest (more are only "
                "counted, as `marks released` in the status)", self.keys.prefix, mark.reason,
            )  # fmt: skip

    def _marks_of(self, reason: str) -> list[Mark]:
        """Marks of a condition, oldest first."""
        return [one for one in self.kept.marks if one.by == BY_STATUS and one.reason == reason]

    def _look_after(self, now: float) -> None:
        if now - self._synced_s >= SYNC_S:
            self._synced_s = now
            self._files.sync()
        if now - self._looked_s >= self._look_s:
            self._looked_s = now
            self._mark()  # what was counted as an error before
            self.kept.look()
            self._look_s = max(LOOK_S, (time.monotonic() - now) / LOOK_SHARE)
        if self._conditions and now - self._watched_s >= WATCH_S:
            self._watched_s = now
            self._watch()

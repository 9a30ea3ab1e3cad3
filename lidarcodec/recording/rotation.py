"""RotatingRecorder: recordings of limited size in a folder of limited size; the oldest are deleted first.

Every file begins with a key message, so it can be read alone. Errors of the disk are counted and stop the recording,
not the stream. Writing blocks as long as the disk does: call it from a thread of its own.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import logging
import os
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import IO, Final

from lidarcodec import wire
from lidarcodec.errors import SettingsError
from lidarcodec.files.spare import SpareHandles
from lidarcodec.frame import Frame
from lidarcodec.interop.foxglove import POINT_DTYPE
from lidarcodec.packet import Packet
from lidarcodec.recording.recorded_files import (
    created,
    is_written,
    lost,
    recorded_files,
    size_of,
    sync_folder,
    thrown_away,
)
from lidarcodec.recording.writer import RecordingWriter
from lidarcodec.settings import StreamSettings, valid_name

logger = logging.getLogger(__name__)

MIN_FILE_BYTES: Final = 2**20
_OVERHEAD: Final = 320
"""Most bytes of overhead for a message in a file: chunk head, indexes, and entry in the summary."""
_FRAME_BYTES: Final = 4096
"""Most bytes of a file without messages."""
_POSE_BYTES: Final = 1536
"""Most bytes of a cloud's head, its pose and its mounting."""
_STEP_NS: Final = 10**9
"""A clock that was set back by so much begins another file, so that the times of a file are one span."""
_LEAST_MESSAGES, _MOST_MESSAGES = 10, 5120
"""A file takes at least so many messages before that. Each time the number doubles, until a file is full: then it is
the least again. So a clock that jumps again and again makes few files."""
_SPARE: Final = 3
"""File handles in reserve: a new file, its folder, and one more."""
_NO_ROOM: Final = (errno.ENOSPC, errno.EDQUOT)


class RotatingRecorder:
    """Writes messages, packets or both of one sensor to files `VEHICLE_SENSOR_TIME_NUMBER.mcap` of a folder.

    counts: `files`, `messages`, `frames` (in messages), `clouds`, `bytes`, `deleted files`,
            `deleted for a full disk` (of these),
            `lost files` (removed, replaced or overwritten by another program during the recording),
            `waiting for a key message` (not written), `not recorded`
    stopped: why recording stopped, None while it runs;  clouds: set this if `write_cloud` will be called
    metadata: further texts for each file that is begun from now on; with other ones, packets begin another file
    stays: whether a file must not be deleted
    thins: whether a full disk deletes the oldest file that may go, instead of stopping the recording. It continues with
        the next key message then
    """

    def __init__(
        self,
        folder: Path,
        vehicle: str,
        sensor: str,
        settings: StreamSettings | None = None,
        *,
        max_file_bytes: int = 256 * 2**20,
        max_total_bytes: int = 8 * 2**30,
        sync_bytes: int = 16 * 2**20,
        metadata: Mapping[str, str] | None = None,
    ) -> None:
        """max_total_bytes: size of all files of this sensor in the folder, including files of earlier runs; sync_bytes:
        most bytes that a power failure may lose; metadata: further texts for each file

        Raises SettingsError if there is no room for two files.
        """
        if max_file_bytes < MIN_FILE_BYTES or max_total_bytes < 2 * max_file_bytes:
            raise SettingsError(
                f"recording needs more space: a file needs at least {MIN_FILE_BYTES} bytes, not {max_file_bytes}, "
f"and the folder at least two files, not {max_total_bytes} bytes", "max_file_bytes",
            )  # fmt: skip
        self.folder = folder
        self.vehicle, self.sensor = valid_name(vehicle, "vehicle"), valid_name(sensor, "sensor")
        self.settings, self.metadata = settings, metadata
        self.max_file_bytes, self.max_total_bytes, self.sync_bytes = max_file_bytes, max_total_bytes, sync_bytes
        self._begun_with = metadata
        self.stays: Callable[[Path], bool] = _never
        self.thins = False
        self.clouds = False
        self.counts: Counter[str] = Counter()
        self.stopped: str | None = None
        self._file: IO[bytes] | None = None
        self._writer: RecordingWriter | None = None
        self._synced = self._in_file = self._newest_ns = 0
        self._patience = _LEAST_MESSAGES
        self._made: list[str] = []
        self._spare = SpareHandles(_SPARE)

    def write(self, data: bytes) -> bool:
        """Record one message, packed by `wire.pack`. Returns whether it was recorded. Files begin at key messages.

        Raises DecodeError for bytes that are not a message.
        """
        header = wire.peek(data)
        self._look_after_file()
        set_back = header.stamp_ns < self._newest_ns - _STEP_NS and self._in_file >= self._patience
        full = self._size_with(len(data)) > self.max_file_bytes
        if header.key and (self._writer is None or set_back or full):
            self._patience = _LEAST_MESSAGES if full else min((1 + set_back) * self._patience, _MOST_MESSAGES)
            self._begin(header.stamp_ns, len(data))
        if self._writer is None and self.stopped is None:
            self.counts["waiting for a key message"] += 1
            return False
        self._newest_ns = header.stamp_ns if not self._in_file else max(self._newest_ns, header.stamp_ns)
        recorded = self._add(len(data), lambda writer: writer.write(data))
        self.counts["frames"] += header.frame_count if recorded else 0
        return recorded

    def write_refinement(self, data: bytes) -> bool:
        """Record one refinement, packed by `layers.pack`, in the current file. Returns whether it was recorded.

        Raises DecodeError for bytes that are not a refinement.
        """
        self._look_after_file()
        if self._writer is None and self.stopped is None:
            self.counts["waiting for a key message"] += 1
            return False
        return self._add(len(data), lambda writer: writer.write_refinement(data), what="refinements")

    def write_packets(self, packets: Sequence[Packet]) -> bool:
        """Record a batch of raw packets. Returns whether it was recorded. A file may begin with any batch."""
        if not packets:
            return True
        self._look_after_file()
        size = sum(len(packet.payload) + 8 for packet in packets)
        other = self._begun_with != self.metadata
        if self._writer is None or other or self._size_with(size) > self.max_file_bytes:
            self._begin(packets[0].stamp_ns, size)
        return self._add(size, lambda writer: writer.write_packets(packets))

    def write_cloud(self, frame: Frame) -> bool:
        """Record the points of a decoded frame in the current file. Returns whether they were recorded."""
        self._look_after_file()
        size = frame.points * POINT_DTYPE.itemsize + _POSE_BYTES
        if self._writer is None and self.stopped is None:
            self.counts["waiting for a key message"] += 1
            return False
        return self._add(size, lambda writer: writer.write_cloud(frame), what="clouds")

    def sync(self) -> None:
        """Make everything written so far survive a power failure."""
        file, writer = self._file, self._writer
        if file is not None and writer is not None and writer.bytes_written > self._synced:
            self._guarded(lambda: self._sync(file, writer))

    @property
    def waits_for_key(self) -> bool:
        """Whether the next message has to be a key message to be recorded."""
        return self._writer is None

    def close(self) -> None:
        """End the current file. A second call does nothing."""
        self._look_after_file()
        self._guarded(self._end)
        self._spare.close()

    @property
    def path(self) -> Path | None:
        """The current file."""
        return None if self._file is None else Path(self._file.name)

    def files(self) -> list[Path]:
        """Files of this sensor in the folder, oldest first."""
        return self._spare.opened(lambda: recorded_files(self.folder, self.vehicle, self.sensor, self._made))

    def _look_after_file(self) -> None:
        """Close the current file if another program removed, replaced or overwrote it: writing would not fail, but the
        content would be lost.
        """
        file = self._file
        if file is None or (what := lost(file)) is None:
            return
        self.counts["lost files"] += 1
        logger.error("%s was %s while it was being recorded: its content is lost", file.name, what)
        self._writer = self._file = None
        with contextlib.suppress(OSError), Path(os.devnull).open("wb") as nowhere:
            os.dup2(nowhere.fileno(), file.fileno())  # so that its buffer is not written into another program's file
            file.close()

    def _size_with(self, more: int) -> int:
        """Size of the current file if a message of `more` bytes is added and the file is closed."""
        written = 0 if self._writer is None else self._writer.bytes_written
        return written + more + _FRAME_BYTES + (self._in_file + 1) * _OVERHEAD

    def _add(self, size: int, write: Callable[[RecordingWriter], None], what: str = "messages") -> bool:
        writer = self._writer
        if self.stopped is None and writer is not None and self._guarded(lambda: self._write(writer, size, write)):
            self.counts[what] += 1
            self.counts["bytes"] += size
            return True
        self.counts["not recorded"] += 1
        return False

    def _write(self, writer: RecordingWriter, size: int, write: Callable[[RecordingWriter], None]) -> None:
        if self._size_with(size) > self.max_file_bytes:  # no key message came before the size limit
            self._make_room(self._size_with(size))
        write(writer)
        self._in_file += 1
        if writer.bytes_written - self._synced >= self.sync_bytes and self._file is not None:
            self._sync(self._file, writer)

    def _sync(self, file: IO[bytes], writer: RecordingWriter) -> None:
        written = writer.bytes_written
        os.fsync(file.fileno())
        self._synced = written

    def _begin(self, stamp_ns: int, first_bytes: int) -> None:
        """Begin a file. If this process cannot open more files, continue the current one instead."""
        if self.stopped is not None or (not self._spare.fill() and self._writer is not None):
            return
        self._guarded(lambda: self._open(stamp_ns, first_bytes))

    def _open(self, stamp_ns: int, first_bytes: int) -> None:
        self._end()
        self._spare.fill()
        self.folder.mkdir(parents=True, exist_ok=True)
        self._make_room(max(self.max_file_bytes, self._size_with(first_bytes)))
        time = datetime.fromtimestamp(max(0, stamp_ns) // 10**9, UTC).strftime("%Y%m%dT%H%M%SZ")
        number = 0
        while True:
            path = self.folder / f"{self.vehicle}_{self.sensor}_{time}_{number:04d}.mcap"
            try:
                file = self._spare.opened(partial(created, path))
                break
            except FileExistsError:
                number += 1
        try:
            self._begun_with = self.metadata
            writer = RecordingWriter(file, self.vehicle, self.sensor, self.settings, self.metadata, clouds=self.clouds)
            file.flush()
            self._spare.opened(lambda: sync_folder(self.folder))
        except BaseException:
            thrown_away(file, path)
            raise
        with contextlib.suppress(OSError):  # some file systems cannot
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        self._made.append(path.name)
        self._file, self._writer = file, writer
        self._synced = self._in_file = 0
        self.counts["files"] += 1

    def _make_room(self, needed: int) -> None:
        """Delete the oldest files until there is room for `needed` bytes; stop the recording if there is not.

        Files of earlier runs are deleted first, then those of this run in order. A file that another recorder is
        writing stays.
        """
        order = {name: number for number, name in enumerate(self._made)}
        found = sorted(self.files(), key=lambda path: order.get(path.name, -1))
        self._made = [path.name for path in found if path.name in order]
        files = [(path, size_of(path)) for path in found if path != self.path]
        total = sum(size for _, size in files)
        for path, size in files:
            if total + needed <= self.max_total_bytes:
                return
            if self.stays(path) or is_written(path):
                continue
            path.unlink(missing_ok=True)
            total -= size
            self.counts["deleted files"] += 1
        if needed + total > self.max_total_bytes and total:
            raise OSError(
                f"marked files fill {self.folder}: release some of the marks"
                if any(map(self.stays, (path for path, _ in files)))
                else f"another program already writes recordings of this stream in {self.folder}: use another folder"
            )
        if needed > self.max_total_bytes:
            raise OSError(
                f"the recording file would exceed the {self.max_total_bytes} bytes of its folder, because no "
                "key frame came to begin another file"
            )

    def _end(self) -> None:
        writer, file = self._writer, self._file
        self._writer = self._file = None
        if writer is None or file is None:
            return
        if not self._in_file:  # even its first message could not be written
            thrown_away(file, Path(file.name))
            self.counts["files"] -= 1
            return
        with file:
            writer.close()
            os.fsync(file.fileno())

    def _guarded(self, work: Callable[[], None]) -> bool:
        """Do the work. Returns whether it succeeded. An error of disk or memory stops the recording."""
        try:
            work()
        except OSError as error:
            if not (self.thins and error.errno in _NO_ROOM and self._thinned()):
                self._stop(f"{error.strerror or error}")
            return False
        except MemoryError:  # a message may be incomplete, which would hide later ones
            self._stop("there was not enough memory")
            return False
        return True

    def _thinned(self) -> bool:
        """End the current file as it is, and delete the oldest one that may go. Returns whether there was one."""
        with contextlib.suppress(OSError, MemoryError):
            self._end()
        gone = next((path for path in self.files() if not self.stays(path) and not is_written(path)), None)
        if gone is None:
            return False
        gone.unlink(missing_ok=True)
        self.counts["deleted files"] += 1
        self.counts["deleted for a full disk"] += 1
        if self.counts["deleted for a full disk"] == 1:
            logger.warning("the disk of %s is full: the oldest recordings there are deleted", self.folder)
        return True

    def _stop(self, reason: str) -> None:
        if self.stopped is None:
            self.stopped = reason
            logger.error("recording to %s stopped: %s", self.folder, reason)
        try:
            self._end()
        except (OSError, MemoryError):
            logger.debug("the last file in %s has no index", self.folder)


def _never(path: Path) -> bool:
    return False

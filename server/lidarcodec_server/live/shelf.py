"""Shelf: the folder of recordings. The folder is the only record of them; there is no other list.

Each recording is a folder of its own, named by its id, with one MCAP file and `about.json` for everything else. If
`about.json` has no end, the recording runs as long as its lock is held, by this server or by another one with this
folder. Without a lock it was interrupted; all its complete messages can still be read.
"""

from __future__ import annotations

import json
import logging
import os
import re
import secrets
import shutil
import time
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final, Literal, Self

from lidarcodec.errors import LidarCodecError
from lidarcodec.files.regular import check_regular, open_regular
from lidarcodec.transport.keys import StreamKeys
from lidarcodec.untrusted.json import read_object
from lidarcodec_server.holding import Hold, held_alone
from lidarcodec_server.limits import SparseLog

logger = logging.getLogger(__name__)

State = Literal["recording", "complete", "failed", "interrupted"]
ID: Final = re.compile(r"[0-9]{8}T[0-9]{6}Z-[0-9a-f]{6}")
ABOUT: Final = "about.json"
MAX_ABOUT_BYTES: Final = 64 * 1024
MAX_LISTED: Final = 10_000
COUNT_S: Final = 10.0
ELSEWHERE: Final = "another server with this recordings folder"


class ShelfError(LidarCodecError):
    """A recording cannot be made, found or played."""


class MissingRecordingError(ShelfError):
    """There is no such recording, or it is not being recorded or played."""


class BusyRecordingError(ShelfError):
    """The recording is being recorded or played, or the wanted name is already used."""


class StorageError(ShelfError):
    """The folder of recordings is full, or cannot be written."""


@dataclass(frozen=True)
class Recording:
    """A recording. Times are in ns since the Unix epoch; ended_ns is None while it runs or if unknown.

    frames: None if they were not counted;  reason: why it ended, or a note that another server is recording it
    """

    id: str
    vehicle: str
    sensor: str
    started_ns: int
    state: State
    by: str | None = None
    ended_ns: int | None = None
    reason: str | None = None
    frames: int | None = None
    size_bytes: int = 0

    def about(self) -> dict[str, Any]:
        """The content of its `about.json`."""
        return {
            "format": 1,
            "vehicle": self.vehicle,
            "sensor": self.sensor,
            "started_ns": self.started_ns,
            "by": self.by,
            "state": self.state,
            "ended_ns": self.ended_ns,
            "reason": self.reason,
            "frames": self.frames,
        }

    @classmethod
    def read(cls, folder: Path) -> Self | None:
        """Read a folder; None if it is no recording."""
        try:
            with open_regular(folder / ABOUT) as file:
                about = read_object(file.read(MAX_ABOUT_BYTES + 1), MAX_ABOUT_BYTES)
            keys = StreamKeys(about["vehicle"], about["sensor"])
            ended, started_ns = about.get("state") in ("complete", "failed"), _whole(about["started_ns"])
            if started_ns is None:
                return None
            elsewhere = not ended and held_alone(folder)
            return cls(
                id=folder.name,
                vehicle=keys.vehicle,
                sensor=keys.sensor,
                started_ns=started_ns,
                state=about["state"] if ended else "recording" if elsewhere else "interrupted",
                by=_text(about.get("by")),
                ended_ns=_whole(about.get("ended_ns")),
                reason=f"{ELSEWHERE} is recording it" if elsewhere else _text(about.get("reason")),
                frames=_whole(about.get("frames")),
                size_bytes=_size_of(folder),
            )
        except (
            OSError,
            ValueError,
            TypeError,
            KeyError,
            OverflowError,
            RecursionError,
            AttributeError,
            LidarCodecError,
        ):
            return None


class Shelf:
    """Reads and writes the folder. Methods wait for the disk: call them from a thread."""

    def __init__(self, folder: Path, *, max_total_bytes: int = 64 * 2**30, min_free_bytes: int = 256 * 2**20) -> None:
        self.folder, self.max_total_bytes, self.min_free_bytes = folder, max_total_bytes, min_free_bytes
        self._warnings = SparseLog(logger)
        self._counted_at, self._others_bytes = float("-inf"), 0
        self._recorded: dict[str, Hold] = {}

    def recordings(self) -> list[Recording]:
        """All recordings, newest first."""
        found = [one for folder in self._folders() if (one := Recording.read(folder)) is not None]
        return sorted(found, key=lambda one: (one.started_ns, one.id), reverse=True)

    def recording(self, name: str) -> Recording:
        """One recording. Raises MissingRecordingError."""
        found = Recording.read(self.path(name))
        if found is None:
            raise MissingRecordingError(f"there is no recording {name}")
        return found

    def path(self, name: str) -> Path:
        """The folder of a recording. Raises MissingRecordingError for an invalid id, so no id leads out of the
        shelf.
        """
        if not ID.fullmatch(name):
            raise MissingRecordingError(f"'{name[:64]}' is not a recording: GET /api/v1/recordings lists their ids")
        return self.folder / name

    def file(self, name: str) -> Path:
        """The MCAP file of a recording. Raises MissingRecordingError, also if it is no regular file."""
        files = sorted(self.path(name).glob("*.mcap"))
        if not files:
            raise MissingRecordingError(f"recording {name} has no file: nothing was received")
        try:
            check_regular(files[0])
        except OSError as error:
            raise MissingRecordingError(f"the file of recording {name} cannot be read: {error.strerror}") from None
        return files[0]

    def create(self, keys: StreamKeys, started_ns: int, by: str | None) -> Recording:
        """Make the folder of a new recording. It stays locked until `release` or `remove`. Raises StorageError."""
        stamp = datetime.fromtimestamp(started_ns // 10**9, UTC).strftime("%Y%m%dT%H%M%SZ")
        made = Recording(f"{stamp}-{secrets.token_hex(3)}", keys.vehicle, keys.sensor, started_ns, "recording", by)
        try:
            self.folder.mkdir(parents=True, exist_ok=True, mode=0o700)
            full = self.full()
            if full is not None:
                raise StorageError(full)
            (self.folder / made.id).mkdir()
            hold = Hold.of(self.folder / made.id, alone=True)  # others ignore the folder until it has `about.json`
            if hold is not None:
                self._recorded[made.id] = hold
            self.note(made)
        except OSError as error:
            self.release(made.id)
            raise self._unusable(error) from None
        return made

    def release(self, name: str) -> None:
        """Unlock a recording that `create` made: nothing more is written to it."""
        hold = self._recorded.pop(name, None)
        if hold is not None:
            hold.close()

    def hold(self, name: str) -> Hold:
        """Keep all servers from deleting a recording until the lock is closed.

        Raises MissingRecordingError, BusyRecordingError, StorageError.
        """
        return self._hold(name, alone=False)

    def note(self, recording: Recording) -> None:
        """Write `about.json` of a recording, completely or not at all. Raises OSError."""
        folder = self.path(recording.id)
        fresh = folder / f"{ABOUT}.new"
        with fresh.open("w", encoding="utf-8") as file:
            json.dump(recording.about(), file)
            file.flush()
            os.fsync(file.fileno())
        fresh.replace(folder / ABOUT)

    def sized(self, recording: Recording) -> Recording:
        """The recording with its present size."""
        return replace(recording, size_bytes=_size_of(self.path(recording.id)))

    def remove(self, name: str) -> None:
        """Delete a recording. Raises MissingRecordingError, BusyRecordingError, StorageError."""
        folder = self.path(self.recording(name).id)
        hold = self._recorded.pop(name, None) or self._hold(name, alone=True)
        try:
            shutil.rmtree(folder)
            self.count_again()
        except OSError as error:
            raise StorageError(f"cannot delete recording {name}: {error.strerror or error}") from None
        finally:
            hold.close()

    def _hold(self, name: str, *, alone: bool) -> Hold:
        try:
            hold = Hold.of(self.path(name), alone=alone)
        except FileNotFoundError:
            raise MissingRecordingError(f"there is no recording {name}") from None
        except OSError as error:
            raise self._unusable(error) from None
        if hold is None:
            doing = "recorded or played" if alone else "recorded or deleted"
            raise BusyRecordingError(f"recording {name} is being {doing} by {ELSEWHERE}: stop it there first")
        return hold

    def full(self, running_bytes: int | None = None) -> str | None:
        """Why nothing more can be recorded; None while there is room. Raises OSError.

        running_bytes: size of the running recordings. If given, the others are measured at most every COUNT_S
        """
        free = shutil.disk_usage(self.folder).free
        if free < self.min_free_bytes:
            return f"the disk has only {free // 2**20} MiB free: {self.min_free_bytes // 2**20} MiB must stay free"
        total = self._total(running_bytes)
        if total >= self.max_total_bytes:
            return f"the recordings take {total // 2**20} MiB: at most {self.max_total_bytes // 2**20} MiB are allowed"
        return None

    def _unusable(self, error: OSError) -> StorageError:
        """The error for clients. It does not name the folder; the log line does."""
        reason = error.strerror or type(error).__name__
        self._warnings.warning("the recordings folder %s cannot be used: %s", self.folder, reason)
        return StorageError(f"the recordings folder of the server cannot be used: {reason}")

    def _total(self, running_bytes: int | None) -> int:
        if running_bytes is None:
            return sum(map(_size_of, self._folders(None)))
        if time.monotonic() - self._counted_at >= COUNT_S:
            self._counted_at = time.monotonic()
            self._others_bytes = self._total(None) - running_bytes
        return self._others_bytes + running_bytes

    def count_again(self) -> None:
        """Call this when a recording has ended or was removed."""
        self._counted_at = float("-inf")

    def _folders(self, most: int | None = MAX_LISTED) -> list[Path]:
        try:
            with os.scandir(self.folder) as entries:
                names = sorted((one.name for one in entries if ID.fullmatch(one.name) and one.is_dir()), reverse=True)
        except FileNotFoundError:
            return []
        except OSError as error:
            raise self._unusable(error) from None
        return [self.folder / name for name in names[:most]]


def _size_of(folder: Path) -> int:
    try:
        with os.scandir(folder) as entries:
            files = [one for one in entries if one.name.endswith(".mcap")]
            return sum(one.stat(follow_symlinks=False).st_size for one in files)
    except OSError:  # deleted meanwhile
        return 0


def _whole(value: object) -> int | None:
    fits = isinstance(value, int) and not isinstance(value, bool) and 0 <= value < 2**63
    return int(value) if fits and isinstance(value, int) else None


def _text(value: object) -> str | None:
    return value if isinstance(value, str) else None

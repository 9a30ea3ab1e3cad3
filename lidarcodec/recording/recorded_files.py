"""Files of recorders in a folder: which ones are of a sensor, which one is written now, and what became of one."""

from __future__ import annotations

import contextlib
import fcntl
import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import IO

from lidarcodec.errors import SourceError
from lidarcodec.files.regular import open_regular
from lidarcodec.files.spare import FULL
from lidarcodec.recording.reader import RecordingReader


def recorded_files(folder: Path, vehicle: str, sensor: str, known: Sequence[str] = ()) -> list[Path]:
    """Files that a RotatingRecorder wrote of a sensor, oldest first. known: names that are certainly of this sensor

    Raises OSError if the folder cannot be read.
    """
    name = re.compile(re.escape(f"{vehicle}_{sensor}_") + r"\d{8}T\d{6}Z_\d{4,}\.mcap")
    found = [path for path in folder.iterdir() if name.fullmatch(path.name)]
    if "_" in vehicle + sensor:  # `car_1`, `roof` and `car`, `1_roof` have equal file names
        found = [path for path in found if path.name in known or _is_of(path, vehicle, sensor)]
    times = {path: _changed_ns(path) for path in found}
    return sorted((path for path in found if times[path] is not None), key=lambda path: (times[path], path.name))


def _is_of(path: Path, vehicle: str, sensor: str) -> bool:
    """Whether the metadata of a file names this sensor."""
    try:
        with open_regular(path) as file:
            about = RecordingReader(file, warn=False).metadata
    except (OSError, SourceError):
        return False
    return (about.get("vehicle"), about.get("sensor")) == (vehicle, sensor)


def created(path: Path) -> IO[bytes]:
    """Create a file. Raises FileExistsError, OSError."""
    return path.open("xb")


def _changed_ns(path: Path) -> int | None:
    """Time of the last change of a file; None if it was removed or is a broken link."""
    try:
        return path.stat().st_mtime_ns
    except OSError:
        return None


def size_of(path: Path) -> int:
    try:
        return path.stat().st_size
    except OSError:  # removed meanwhile
        return 0


def lost(file: IO[bytes]) -> str | None:
    """`removed`, `replaced` or `written over` if the content of an open file is lost; None otherwise."""
    ours = os.fstat(file.fileno())
    if ours.st_size != os.lseek(file.fileno(), 0, os.SEEK_CUR):
        return "written over"
    try:
        there = Path(file.name).stat()
    except OSError:
        return "removed"
    return None if (there.st_dev, there.st_ino) == (ours.st_dev, ours.st_ino) else "replaced"


def thrown_away(file: IO[bytes], path: Path) -> None:
    """Close and delete a file without a complete message."""
    with contextlib.suppress(OSError):
        file.close()
    path.unlink(missing_ok=True)


def is_written(path: Path) -> bool:
    """Whether another recorder holds the lock of a file that it is writing."""
    try:
        with open_regular(path) as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError as error:  # the file system has no locks, or the file cannot be read
        return error.errno in FULL
    return False


def sync_folder(folder: Path) -> None:
    """Make the name of a new file survive a power failure."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)

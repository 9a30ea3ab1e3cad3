"""Uploads the recordings of a vehicle to a store. Run again, it continues with the first file that is not there yet."""

from __future__ import annotations

import contextlib
import hashlib
import logging
import os
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, BinaryIO, Final

from lidarcodec.archive.inputs import NOTE, SENSOR, VEHICLE
from lidarcodec.archive.names import json_of
from lidarcodec.archive.stores.base import Store, check_name
from lidarcodec.errors import SourceError
from lidarcodec.files.regular import open_regular
from lidarcodec.recording import RecordingReader
from lidarcodec.recording.recorded_files import is_written
from lidarcodec.settings import is_name
from lidarcodec.untrusted.json import MAX_BYTES, read_json

logger = logging.getLogger(__name__)

_STEP: Final = 1 << 18
"""Bytes that are read at once: the rate is kept over pieces of this size."""


class Rate:
    """Limits a rate in bytes a second; None: no limit."""

    def __init__(
        self,
        limit: float | None,
        clock: Callable[[], float] = time.monotonic,
        pause: Callable[[float], object] = time.sleep,
    ) -> None:
        self._limit, self._clock, self._pause = limit, clock, pause
        self._free_s = clock()

    def spend(self, count: int) -> None:
        """Wait until `count` bytes may be sent."""
        if self._limit is None:
            return
        now_s = self._clock()
        if self._free_s > now_s:
            self._pause(self._free_s - now_s)
        self._free_s = max(now_s, self._free_s) + count / self._limit


def push(
    folder: Path,
    store: Store,
    *,
    rate: Rate,
    delete: bool = False,
    stopped: Callable[[], bool] = lambda: False,
    tick: Callable[[], None] = lambda: None,
) -> Counter[str]:
    """Upload the recordings of a folder as `VEHICLE/SENSOR/FILE`, oldest first, each with its SHA-256 in
    `FILE.sha256.json`. Where the store has another recording of this name, a part of the SHA-256 is added to FILE.

    Recordings of a server lie in a folder each, whose name becomes a part of FILE. A file that is being written waits
    for the next time. delete: remove a file here after it was read back from the store and is the same; those of a
    server stay, for it knows them. Returns numbers: `uploaded`, `bytes`, `already_there`, `deleted`, `still_written`,
    `unreadable`, `gone` (removed by another program meanwhile).
    Raises SourceError if the store holds something else than was sent, OSError.
    """
    counts: Counter[str] = Counter()
    for path in _oldest_first(folder):
        if stopped():
            counts["interrupted"] = 1
            break
        if is_written(path):
            counts["still_written"] += 1
            continue
        try:
            file = open_regular(path)
        except FileNotFoundError:
            counts["gone"] += 1
            continue
        except OSError as error:
            logger.warning("a file was left out: %s", error)
            counts["unreadable"] += 1
            continue
        before = os.fstat(file.fileno())
        with file:  # open from here on: if the recorder removes the file, its bytes stay
            served = path.parent != folder
            name = _name(file, f"{path.parent.name}-{path.name}" if served else path.name)
            if name is None:
                logger.warning("a file was left out: %s is not a recording, or its name has odd characters", path)
                counts["unreadable"] += 1
                continue
            stored, told = _uploaded(file, name, store, rate, counts)
            if delete and not served:
                _check_stored(store, stored, told["sha256"], path)
                counts["deleted"] += _delete(path, before)
        tick()
    return counts


def _oldest_first(folder: Path) -> list[Path]:
    """The recordings in a folder. Those that vanish meanwhile are left out."""
    found = []
    inside = (path for path in folder.glob("*/*.mcap") if not path.parent.is_symlink())
    for path in (*folder.glob("*.mcap"), *inside):
        with contextlib.suppress(FileNotFoundError):
            found.append((path.stat().st_mtime_ns, path.name, path))
    return [path for _, _, path in sorted(found)]


def _uploaded(
    file: BinaryIO, wanted: str, store: Store, rate: Rate, counts: Counter[str]
) -> tuple[str, dict[str, Any]]:
    """Upload a file if the store does not have it. Returns its name there, and what its note says."""
    digest = hashlib.sha256()
    size = 0
    for chunk in _pieces(file, Rate(None)):
        digest.update(chunk)
        size += len(chunk)
    told = {"sha256": digest.hexdigest(), "bytes": size}
    names = _names(wanted, digest.hexdigest())
    noted = (one for one in names if _told(store, one) == told)
    name = next(noted, None) or next((one for one in names if _reserved(store, one, told)), None)
    if name is None:
        raise SourceError(
            f"the store already has other objects with the names of {wanted}: the local recording was kept"
        )
    if store.size(name) == size:
        counts["already_there"] += 1
        return name, told
    if name != wanted:
        logger.warning("the store already has another recording named %s: this one is stored as %s", wanted, name)
    store.upload(name, _pieces(file, rate))
    if store.size(name) != size:
        raise SourceError(f"{name} in the store does not have the size that was sent: the local recording was kept")
    counts["uploaded"] += 1
    counts["bytes"] += size
    return name, told


def _names(name: str, sha256: str) -> list[str]:
    """Names that a recording may have, the first one preferred.

    A clock that starts at the same time after each boot, or two vehicles of one name, give two recordings one name.
    """
    stem, _, ending = name.rpartition(".")
    return [name, *(f"{stem}-{sha256[:digits]}.{ending}" for digits in (8, len(sha256)))]


def _reserved(store: Store, name: str, told: dict[str, Any]) -> bool:
    """Whether a name without a note could be taken for this recording, by creating its note.

    A note is created before its object, once: who finds the note of another recording leaves the object alone. An
    object without a note was copied by other means: it is this recording only if it has the same bytes.
    """
    if _told(store, name) is not None:
        return False
    size = store.size(name)
    if size is not None and (size != told["bytes"] or _sha256(store, name) != told["sha256"]):
        return False
    return store.create(_note(name), json_of(told)) or _told(store, name) == told


def _sha256(store: Store, name: str) -> str:
    digest = hashlib.sha256()
    for chunk in store.chunks(name):
        digest.update(chunk)
    return digest.hexdigest()


def _check_stored(store: Store, name: str, expected: str, path: Path) -> None:
    """Raise SourceError if the store does not give back the same bytes."""
    if _sha256(store, name) != expected:
        raise SourceError(f"{name} in the store differs from {path}, which was kept")


def _delete(path: Path, read: os.stat_result) -> bool:
    """Remove a file here, unless it was changed or replaced since it was opened. Returns whether it was removed."""
    try:
        there = path.lstat()
        if _identity(there) != _identity(read):
            raise SourceError(f"{path} changed while it was uploaded: it was kept")
        path.unlink()
    except FileNotFoundError:
        return False
    return True


def _identity(found: os.stat_result) -> tuple[int, ...]:
    return found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns


def _name(file: BinaryIO, name: str) -> str | None:
    """Name of the object of a recording; None if the file is no recording, or has a name that no object may have."""
    try:
        about = RecordingReader(file, warn=False).metadata
        vehicle, sensor = about.get("vehicle", VEHICLE), about.get("sensor", SENSOR)
        return check_name(f"{vehicle}/{sensor}/{name}") if is_name(vehicle) and is_name(sensor) else None
    except SourceError:  # no recording, or an odd name
        return None


def _note(name: str) -> str:
    return f"{name}{NOTE}"


def _told(store: Store, name: str) -> object:
    """What the note of a name says, None if there is none; what is wrong with it if it cannot be read."""
    try:
        return read_json(store.read_small(_note(name), MAX_BYTES))
    except FileNotFoundError:
        return None
    except (ValueError, SourceError) as error:
        return str(error)


def _pieces(file: BinaryIO, rate: Rate) -> Iterator[bytes]:
    file.seek(0)
    while chunk := file.read(_STEP):
        rate.spend(len(chunk))
        yield chunk

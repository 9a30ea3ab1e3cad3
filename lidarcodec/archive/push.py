"""Uploads the recordings of a vehicle to a store. Run again, it continues with the first file that is not there yet."""

from __future__ import annotations

import hashlib
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final

from lidarcodec.archive.inputs import NOTE, SENSOR, VEHICLE
from lidarcodec.archive.names import json_of
from lidarcodec.archive.stores.base import Store
from lidarcodec.errors import SourceError
from lidarcodec.files.regular import open_regular
from lidarcodec.recording import RecordingReader
from lidarcodec.recording.rotation import is_written
from lidarcodec.settings import is_name
from lidarcodec.untrusted.json import read_json

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
    `FILE.sha256.json`.

    A file that is being written waits for the next time. delete: remove a file here after it was read back from the
    store and is the same. Returns numbers: `uploaded`, `bytes`, `already_there`, `deleted`, `still_written`,
    `unreadable`.
    Raises SourceError if the store holds something else than was sent, OSError.
    """
    counts: Counter[str] = Counter()
    for path in sorted(folder.glob("*.mcap"), key=lambda one: (one.stat().st_mtime_ns, one.name)):
        if stopped():
            counts["interrupted"] = 1
            break
        if is_written(path):
            counts["still_written"] += 1
            continue
        name = _name(path)
        if name is None:
            counts["unreadable"] += 1
            continue
        before = path.stat()
        digest = hashlib.sha256()
        for chunk in _pieces(path, Rate(None)):
            digest.update(chunk)
        told = {"sha256": digest.hexdigest(), "bytes": before.st_size}
        if _told(store, name) == told and store.size(name) == before.st_size:
            counts["already_there"] += 1
        else:
            store.upload(name, _pieces(path, rate))
            if store.size(name) != before.st_size:
                raise SourceError(f"{name} in the store has another size than {path}: it was kept here")
            store.upload(_note(name), [json_of(told)])
            counts["uploaded"] += 1
            counts["bytes"] += before.st_size
        if delete:
            _delete(path, before.st_mtime_ns, store, name, told["sha256"])
            counts["deleted"] += 1
        tick()
    return counts


def _delete(path: Path, changed_ns: int, store: Store, name: str, expected: object) -> None:
    """Remove a file here, if the store gives back the same bytes."""
    digest = hashlib.sha256()
    for chunk in store.chunks(name):
        digest.update(chunk)
    if digest.hexdigest() != expected or path.stat().st_mtime_ns != changed_ns:
        raise SourceError(f"{name} in the store is not what {path} holds: it was kept here")
    path.unlink()


def _name(path: Path) -> str | None:
    """Name of the object of a recording; None if the file is no recording."""
    try:
        with open_regular(path) as file:
            about = RecordingReader(file, warn=False).metadata
    except SourceError:
        return None
    vehicle, sensor = about.get("vehicle", VEHICLE), about.get("sensor", SENSOR)
    if not is_name(vehicle) or not is_name(sensor):
        return None
    return f"{vehicle}/{sensor}/{path.name}"


def _note(name: str) -> str:
    return f"{name}{NOTE}"


def _told(store: Store, name: str) -> object:
    try:
        return read_json(store.read(_note(name)))
    except (FileNotFoundError, ValueError):
        return None


def _pieces(path: Path, rate: Rate) -> Iterator[bytes]:
    with open_regular(path) as file:
        while chunk := file.read(_STEP):
            rate.spend(len(chunk))
            yield chunk

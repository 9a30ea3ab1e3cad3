"""An input of an archive as an open source of packets."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from lidarcodec.archive.inputs import SENSOR, VEHICLE, Input
from lidarcodec.archive.scratch import KEPT, local
from lidarcodec.archive.stores.base import Entry, Store
from lidarcodec.evaluation.recorded import RecordedFrames
from lidarcodec.files.regular import open_regular
from lidarcodec.recording import RecordingReader
from lidarcodec.settings import is_name
from lidarcodec.sources import open_source
from lidarcodec.sources.base import PacketSource
from lidarcodec.sources.poses import Poses
from lidarcodec.sources.recording import RecordingSource


def input_of(value: dict[str, Any]) -> Input:
    """The input in the values of a task."""
    fields = dict(value["input"])
    fields["beside"] = tuple(Entry(*one) for one in fields["beside"])
    return Input(**fields)


def made_from(found: dict[str, Any], source: Store) -> Input | None:
    """The input of a segment; None if it is not there any more as it was, or the segment was made from another one."""
    if found.get("job") != "compress":
        return None
    beside = tuple(Entry(*one) for one in found["beside"])
    one = Input(found["input"], found["input_size"], found["input_tag"], found["vehicle"], found["sensor"], beside)
    entries = beside if one.name.endswith("/") else (*beside, Entry(one.name, one.size, one.tag))
    return one if all(source.entry(entry.name) == entry for entry in entries) else None


@contextmanager
def opened(store: Store, one: Input, *, posed: bool = False) -> Iterator[PacketSource]:
    """The packets of an input.

    posed: with their poses: those of `NAME_poses.npz` beside it, otherwise those that a recording has
    Raises SourceError and others if it cannot be read, OSError if the store fails.
    """
    path = local(store, one)
    poses = _poses(path, one)
    with open_source(path, poses=poses) as source:
        if posed and isinstance(source, RecordingSource) and source.channel == "messages" and source.poses is None:
            source.poses = _recorded_poses(path, path.stat().st_mtime_ns)
        yield source


def named(source: PacketSource, one: Input) -> tuple[str, str]:
    """Vehicle and sensor of an input: by its folders, otherwise by the recording itself."""
    vehicle, sensor = one.vehicle, one.sensor
    if isinstance(source, RecordingSource) and (vehicle, sensor) == (VEHICLE, SENSOR):
        with open_regular(source.path) as file:
            about = RecordingReader(file, warn=False).metadata
        vehicle, sensor = about.get("vehicle", vehicle), about.get("sensor", sensor)
    return (vehicle if is_name(vehicle) else VEHICLE), (sensor if is_name(sensor) else SENSOR)


@lru_cache(maxsize=KEPT)
def _recorded_poses(path: Path, changed_ns: int) -> Poses | None:
    """Poses in the messages of a recording; None if there are none. The next segments of the input need them, too."""
    del changed_ns
    known: dict[int, Any] = {}
    for frame in RecordedFrames(path):
        if frame.pose is not None:
            known[frame.stamp_ns] = frame.pose
        elif not known:  # the first frame has none: neither have the others
            return None
    stamps = sorted(known)
    return Poses(np.array(stamps, np.int64), np.stack([known[stamp] for stamp in stamps])) if known else None


def _poses(path: Path, one: Input) -> Path | None:
    found = next((entry for entry in one.beside if entry.name.endswith("_poses.npz")), None)
    return None if found is None else path.with_name(found.name.rpartition("/")[2])

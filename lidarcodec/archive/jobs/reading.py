"""An input of an archive as an open source of packets."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from lidarcodec.archive.inputs import SENSOR, VEHICLE, Input
from lidarcodec.archive.scratch import local
from lidarcodec.archive.stores.base import Entry, Store
from lidarcodec.files.regular import open_regular
from lidarcodec.recording import RecordingReader
from lidarcodec.settings import is_name
from lidarcodec.sources import open_source
from lidarcodec.sources.base import PacketSource
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
def opened(store: Store, one: Input) -> Iterator[PacketSource]:
    """The packets of an input; with `NAME_poses.npz` beside it, its poses too.

    Raises SourceError and others if it cannot be read, OSError if the store fails.
    """
    path = local(store, one)
    poses = _poses(path, one)
    with open_source(path, poses=poses) as source:
        yield source


def named(source: PacketSource, one: Input) -> tuple[str, str]:
    """Vehicle and sensor of an input: by its folders, otherwise by the recording itself."""
    vehicle, sensor = one.vehicle, one.sensor
    if isinstance(source, RecordingSource) and (vehicle, sensor) == (VEHICLE, SENSOR):
        with open_regular(source.path) as file:
            about = RecordingReader(file, warn=False).metadata
        vehicle, sensor = about.get("vehicle", vehicle), about.get("sensor", sensor)
    return (vehicle if is_name(vehicle) else VEHICLE), (sensor if is_name(sensor) else SENSOR)


def _poses(path: Path, one: Input) -> Path | None:
    found = next((entry for entry in one.beside if entry.name.endswith("_poses.npz")), None)
    return None if found is None else path.with_name(found.name.rpartition("/")[2])

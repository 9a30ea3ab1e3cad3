"""Inputs of an archive: captures, recordings and bags in a store, each with the files beside it that it needs.

>>> entries = [Entry("car-7/roof/a.pcap", 10, "1"), Entry("car-7/roof/a_db.xml", 5, "2"), Entry("notes.txt", 1, "3")]
>>> [(one.name, one.vehicle, one.sensor, [more.name for more in one.beside]) for one in inputs_of(entries)]
[('car-7/roof/a.pcap', 'car-7', 'roof', ['car-7/roof/a_db.xml'])]
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Final

from lidarcodec.archive.names import id_of
from lidarcodec.archive.stores.base import Entry, check_name
from lidarcodec.errors import SourceError
from lidarcodec.settings import is_name

_KINDS: Final = re.compile(r"\.(pcapng|pcap|mcap|bag|db3)(\.(xz|zst|gz))?$", re.IGNORECASE)
BAG: Final = "metadata.yaml"
"""This file makes a folder a bag of ROS 2."""
MAX_BESIDE_BYTES: Final = 16 << 20
"""Largest file beside a capture that is taken for a calibration, metadata or poses."""
NOTE: Final = ".sha256.json"
"""Ending of the name of what `archive push` notes of a recording."""
VEHICLE: Final = "vehicle"
SENSOR: Final = "lidar"
_SEPARATORS: Final = re.compile(r"[_. ]+")


@dataclass(frozen=True)
class Input:
    """A capture, a recording, or a bag.

    name: of the object, or of the folder of a bag (with `/` at its end);  size, tag: as in the listing
    vehicle, sensor: names by its folders: `VEHICLE/SENSOR/.../FILE`
    beside: objects that must lie beside it: calibration, metadata, poses, or all files of a bag
    refused: why it is not read, None if it is
    """

    name: str
    size: int
    tag: str
    vehicle: str
    sensor: str
    beside: tuple[Entry, ...] = ()
    refused: str | None = None

    def identity(self) -> list[Any]:
        """Plain values that change when the input or a file beside it changes."""
        return [self.name, self.size, self.tag, [list(one) for one in self.beside]]

    def id(self, *more: Any) -> str:
        """The id of this input; with settings if given."""
        return id_of("input", self.identity(), *more)

    def name_id(self) -> str:
        """The id of its name alone."""
        return id_of("name", self.name)


def inputs_of(entries: Iterable[Entry]) -> Iterator[Input]:
    """The inputs of a listing, in its order. Other objects are passed over.

    A name that leaves the store's folder becomes a refused input.
    """
    folders: dict[str, list[Entry]] = {}
    for entry in entries:
        folders.setdefault(entry.name.rpartition("/")[0], []).append(entry)
    bags = tuple(f"{folder}/" for folder, found in folders.items() if folder and _is_bag(found))
    for folder in sorted(folders):
        found = folders.pop(folder)
        if f"{folder}/" in bags:
            vehicle, sensor = _names(folder.split("/")[:-1])
            size = sum(one.size for one in found)
            refused = next((why for one in found if (why := _refused(one))), None)
            yield Input(f"{folder}/", size, "", vehicle, sensor, tuple(found), refused)
        elif not f"{folder}/".startswith(bags):
            yield from _captures(folder, {one.name.rpartition("/")[2]: one for one in found})


def _is_bag(found: list[Entry]) -> bool:
    return any(one.name.endswith(f"/{BAG}") for one in found)


def _captures(folder: str, names: dict[str, Entry]) -> Iterator[Input]:
    """The inputs among the files of a folder."""
    vehicle, sensor = _names(folder.split("/") if folder else [])
    tables = {name: one for name, one in names.items() if name.endswith(".json") and not name.endswith(NOTE)}
    for name, one in names.items():
        if _KINDS.search(name) is None:
            continue
        refused = _refused(one)
        beside = () if refused else tuple(_beside(_KINDS.sub("", name), names, tables))
        yield Input(one.name, one.size, one.tag, vehicle, sensor, beside, refused)


def _names(folders: list[str]) -> tuple[str, str]:
    """Vehicle and sensor by the names of folders."""
    vehicle = folders[0] if folders and is_name(folders[0]) else VEHICLE
    sensor = folders[1] if len(folders) > 1 and is_name(folders[1]) else SENSOR
    return vehicle, sensor


def _refused(entry: Entry) -> str | None:
    if entry.size < 0:
        return "it is a link that leaves its folder"
    try:
        check_name(entry.name)
    except SourceError as error:
        return str(error)
    return None


def _beside(stem: str, names: dict[str, Entry], tables: dict[str, Entry]) -> Iterator[Entry]:
    """Files that readers look for beside a capture: calibration, metadata of an Ouster, poses."""
    wanted = [f"{stem}_db.xml", f"{stem}.yaml", f"{stem}.csv", "db.xml", f"{stem}_poses.npz", f"{stem}.json"]
    found = [names[name] for name in wanted if name in names]
    if tables and f"{stem}.json" not in tables:
        parts = _SEPARATORS.split(stem)
        common = {name: _common(parts, _SEPARATORS.split(name.removesuffix(".json"))) for name in tables}
        most = max(common.values())
        found += [tables[name] for name in sorted(tables) if most and common[name] == most]
    yield from (one for one in found if 0 <= one.size <= MAX_BESIDE_BYTES)


def _common(one: list[str], other: list[str]) -> int:
    return next((at for at, (a, b) in enumerate(zip(one, other, strict=False)) if a != b), min(len(one), len(other)))

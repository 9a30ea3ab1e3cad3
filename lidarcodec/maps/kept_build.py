"""KeptBuild: what the build of a map has done, in a folder, so that the same command goes on after any end of it.

`kept.json` names the files of the last state. It takes the place of the one before in one step, when they are on disk.
Files that it does not name are removed when a build goes on.
"""

from __future__ import annotations

import json
import re
import time
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

from lidarcodec.errors import SettingsError, SourceError
from lidarcodec.evaluation.trajectory import Trajectory
from lidarcodec.files.regular import open_regular
from lidarcodec.files.renaming import synced
from lidarcodec.files.whole import written_whole
from lidarcodec.maps.align import Alignment
from lidarcodec.maps.build import MapBuilder
from lidarcodec.untrusted.json import JsonRefusedError, read_json

EVERY_S: Final = 30.0
NAME: Final = "kept.json"
MOST_BYTES: Final = 1 << 24
_OURS: Final = re.compile(r"kept\.json|-?\d+_-?\d+-\d+\.npz|state-\d+\.npz|drive-\d+\.npz")


@dataclass
class Begun:
    """A drive in the map. number: of the drive;  scans: how many were added;  whole: whether these are all
    alignment: the fields of its Alignment; None if its poses were taken as they are"""

    number: int
    alignment: list[Any] | None = None
    scans: int = 0
    whole: bool = False

    def aligned(self) -> Alignment | None:
        """Its Alignment."""
        if self.alignment is None:
            return None
        transform, *rest = self.alignment
        return Alignment(np.array(transform), *rest)


@dataclass
class _State:
    wanted: dict[str, Any]
    builder: dict[str, Any] = field(default_factory=dict)
    arrays: str | None = None
    begun: list[Begun] = field(default_factory=list)
    found: dict[str, str] = field(default_factory=dict)


class KeptBuild:
    """The state of a build. wanted: all that decides what the map will hold, as values of JSON

    scans: how many are in the map from before
    """

    def __init__(self, folder: Path, wanted: dict[str, Any], *, force: bool = False) -> None:
        """folder: there, and nobody else's;  force: whether another build that was begun there is given up

        Raises SettingsError if another build was begun there.
        """
        self.folder = folder
        self._state = _State(json.loads(json.dumps(wanted)))
        self._at_s = time.monotonic()
        if (folder / NAME).exists():
            there = self._read()
            if there.wanted == self._state.wanted:
                self._state = there
            elif not force:
                raise SettingsError(
                    f"{folder} holds a build of other drives, or with other options: run the command that began it, or "
                    "add --force to begin anew"
                )
        self.scans: int = self._state.builder.get("scans", 0)
        named = {self._state.arrays, *self._state.found.values()} | ({NAME} if self.saved else set())
        named |= {name for _, _, name in self._state.builder.get("far", [])}
        self._remove_all_but(named)

    def go_on(self, builder: MapBuilder) -> None:
        """Give a new builder what was done. Raises SourceError if that cannot be read."""
        if self._state.arrays is None:
            return
        try:
            with np.load(self.folder / self._state.arrays) as file:
                builder.go_on(self._state.builder, dict(file))
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise self._unreadable(error) from None

    @property
    def saved(self) -> bool:
        """Whether anything would be lost without the folder."""
        return self._state.arrays is not None or bool(self._state.found)

    def begun(self) -> list[Begun]:
        """The drives in the map, in their order; the last one may not be whole."""
        return self._state.begun

    def begin(self, number: int, alignment: Alignment | None) -> Begun:
        """A drive is added from now on, or goes on, or is whole."""
        for one in self._state.begun:
            if one.number == number:
                return one
        fields = None if alignment is None else [alignment.transform.tolist(), *alignment[1:]]
        self._state.begun.append(Begun(number, fields))
        return self._state.begun[-1]

    def trajectory(self, number: int) -> Trajectory | None:
        """The poses that were found of a drive. Raises SourceError if they cannot be read."""
        name = self._state.found.get(str(number))
        if name is None:
            return None
        try:
            with np.load(self.folder / name) as file:
                return Trajectory(file["stamps_ns"], file["matrices"], file["velocities"])
        except (OSError, ValueError, KeyError) as error:
            raise self._unreadable(error) from None

    def keep_trajectory(self, number: int, found: Trajectory) -> None:
        """Keep the poses that were found of a drive."""
        name = f"drive-{number}.npz"
        with written_whole(self.folder / name) as beside:
            np.savez(beside, stamps_ns=found.stamps_ns, matrices=found.matrices, velocities=found.velocities)
        self._state.found[str(number)] = name
        self._write()

    def due(self) -> bool:
        """Whether it is time for `save`."""
        return time.monotonic() - self._at_s >= EVERY_S

    def save(self, builder: MapBuilder) -> None:
        """Keep what a builder has. Raises SourceError if that cannot be written."""
        values, arrays = builder.state()
        before, number = self._state.arrays, int(self._state.builder.get("number", -1)) + 1
        name = f"state-{number}.npz"
        with written_whole(self.folder / name) as beside:
            np.savez(beside, **arrays)
        known = {file for _, _, file in self._state.builder.get("far", [])}
        for _, _, file in values["far"]:
            if file not in known:
                synced(self.folder / file)
        self._state.builder, self._state.arrays = {**values, "number": number}, name
        self._write()
        builder.let_go()
        if before is not None:
            (self.folder / before).unlink(missing_ok=True)
        self._at_s = time.monotonic()

    def clear(self) -> None:
        """The map is there: remove all files."""
        self._remove_all_but(set())

    def _remove_all_but(self, named: set[str | None]) -> None:
        for path in self.folder.iterdir():
            if path.name not in named and _OURS.fullmatch(path.name):
                path.unlink()

    def _read(self) -> _State:
        try:
            with open_regular(self.folder / NAME) as file:
                values = read_json(file.read(MOST_BYTES + 1), MOST_BYTES)
            state = _State(**values)
            state.begun = [Begun(**one) for one in values["begun"]]
        except (OSError, JsonRefusedError, TypeError, KeyError) as error:
            raise self._unreadable(error) from None
        return state

    def _write(self) -> None:
        with written_whole(self.folder / NAME) as beside:
            beside.write_text(json.dumps(asdict(self._state)))

    def _unreadable(self, error: Exception) -> SourceError:
        return SourceError(f"{self.folder} cannot be read ({error}): delete it, and the build begins anew")

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
from typing import Annotated, Any, Final

import numpy as np
from pydantic import Field, TypeAdapter, ValidationError

from lidarcodec.budgets import largest
from lidarcodec.errors import SettingsError, SourceError
from lidarcodec.evaluation.trajectory import Trajectory
from lidarcodec.files.regular import open_regular
from lidarcodec.files.renaming import synced
from lidarcodec.files.whole import written_whole
from lidarcodec.maps.align import Alignment
from lidarcodec.maps.build import MapBuilder
from lidarcodec.untrusted.json import JsonRefusedError, read_json
from lidarcodec.untrusted.npz import Arrays, read_npz

EVERY_S: Final = 30.0
NAME: Final = "kept.json"
MOST_BYTES: Final = 1 << 24
MOST_ARRAYS: Final = largest("arrays") or 0
_TILE, _ARRAYS, _DRIVE = r"-?\d+_-?\d+-\d+\.npz", r"state-\d+\.npz", r"drive-\d+\.npz"
_OURS: Final = re.compile(rf"kept\.json|{_TILE}|{_ARRAYS}|{_DRIVE}")
_Count = Annotated[int, Field(ge=0, lt=2**31)]
_Number = Annotated[float, Field(allow_inf_nan=False)]
_Row = Annotated[list[_Number], Field(min_length=4, max_length=4)]
_Rows = Annotated[list[_Row], Field(min_length=4, max_length=4)]


def _name(pattern: str) -> Any:
    """The name of a file of this folder, and of no other one: what is not used any more is removed."""
    return Field(pattern=f"^(?:{pattern})$", max_length=64)


@dataclass
class _Builder:
    """What MapBuilder.state gives, and the number of the file of its arrays."""

    far: list[tuple[int, int, Annotated[str, _name(_TILE)]]] = field(default_factory=list)
    grid_scans: _Count = 0
    before: Annotated[list[_Number], Field(min_length=3, max_length=3)] | None = None
    length_m: _Number = 0.0
    scans: _Count = 0
    number: int = -1


@dataclass
class Begun:
    """A drive in the map. number: of the drive;  scans: how many were added;  whole: whether these are all
    alignment: the fields of its Alignment; None if its poses were taken as they are"""

    number: _Count
    alignment: tuple[_Rows, _Count, _Count, _Number, _Number, _Number] | None = None
    scans: _Count = 0
    whole: bool = False

    def aligned(self) -> Alignment | None:
        """Its Alignment."""
        if self.alignment is None:
            return None
        transform, scans, of, overlap, residual_m, residual_deg = self.alignment
        return Alignment(np.array(transform), scans, of, overlap, residual_m, residual_deg)


@dataclass
class _State:
    wanted: dict[str, Any]
    builder: _Builder = field(default_factory=_Builder)
    arrays: Annotated[str, _name(_ARRAYS)] | None = None
    begun: list[Begun] = field(default_factory=list)
    found: dict[str, Annotated[str, _name(_DRIVE)]] = field(default_factory=dict)


_READER: Final = TypeAdapter(_State)


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
        self.scans: int = self._state.builder.scans
        named = {self._state.arrays, *self._state.found.values()} | ({NAME} if self.saved else set())
        named |= {name for _, _, name in self._state.builder.far}
        self._remove_all_but(named)

    def go_on(self, builder: MapBuilder) -> None:
        """Give a new builder what was done. Raises SourceError if that cannot be read."""
        if self._state.arrays is None:
            return
        try:
            builder.go_on(asdict(self._state.builder), self._arrays(self._state.arrays))
        except (OSError, ValueError, LookupError, TypeError) as error:
            raise self._unreadable(error) from None

    @property
    def saved(self) -> bool:
        """Whether anything would be lost without the folder."""
        return self._state.arrays is not None or bool(self._state.found)

    def begun(self, drives: int) -> list[Begun]:
        """The drives in the map, in their order; the last one may not be whole. drives: how many there are

        Raises SourceError if there are fewer than the folder says.
        """
        if any(one.number >= drives for one in self._state.begun):
            raise self._unreadable(ValueError("it has more drives than there are"))
        return self._state.begun

    def begin(self, number: int, alignment: Alignment | None) -> Begun:
        """A drive is added from now on, or goes on, or is whole."""
        for one in self._state.begun:
            if one.number == number:
                return one
        about = None if alignment is None else (alignment.transform.tolist(), *alignment[1:])
        self._state.begun.append(Begun(number, about))
        return self._state.begun[-1]

    def trajectory(self, number: int) -> Trajectory | None:
        """The poses that were found of a drive. Raises SourceError if they cannot be read."""
        name = self._state.found.get(str(number))
        if name is None:
            return None
        try:
            found = self._arrays(name)
            return Trajectory(found["stamps_ns"], found["matrices"], found["velocities"])
        except (OSError, ValueError, LookupError) as error:
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
        before, number = self._state.arrays, self._state.builder.number + 1
        name = f"state-{number}.npz"
        with written_whole(self.folder / name) as beside:
            np.savez(beside, **arrays)
        known = {file for _, _, file in self._state.builder.far}
        for _, _, file in values["far"]:
            if file not in known:
                synced(self.folder / file)
        self._state.builder, self._state.arrays = _Builder(**values, number=number), name
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
            return _READER.validate_python({**values, "begun": values["begun"]})
        except ValidationError as error:
            first = error.errors()[0]
            where = ".".join(map(str, first["loc"]))
            raise self._unreadable(ValueError(f"{where}: {first['msg']}")) from None
        except (OSError, JsonRefusedError, TypeError, KeyError) as error:
            raise self._unreadable(error) from None

    def _arrays(self, name: str) -> Arrays:
        """Raises OSError, ArraysRefusedError."""
        return read_npz(self.folder / name, most_bytes=MOST_ARRAYS)

    def _write(self) -> None:
        with written_whole(self.folder / NAME) as beside:
            beside.write_text(json.dumps(asdict(self._state)))

    def _unreadable(self, error: Exception) -> SourceError:
        return SourceError(f"{self.folder} cannot be read ({error}): delete it, and the build begins anew")

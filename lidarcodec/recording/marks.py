"""Marks: spans of time whose recordings must not be deleted, kept in a small file beside them.

>>> from pathlib import Path
>>> marks = Marks(Path("car-7_roof.marks.json"))
>>> marks.add(Mark("crash", 100, 200, "airbag", "status", 150))
>>> marks.covers(200, 300), Marks(marks.path).covers(150, 151)
(False, True)
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

from lidarcodec.errors import LidarCodecError, SettingsError, SourceError
from lidarcodec.files.regular import open_regular
from lidarcodec.files.whole import written_whole
from lidarcodec.settings import is_name
from lidarcodec.untrusted.json import JsonRefusedError, read_object

MAX_MARKS: Final = 256
OF_OTHERS: Final = 0.75
"""Share of the places and of the text that marks over the network may take: the rest is for the vehicle's own."""
MAX_MARK_NS: Final = 600 * 10**9
"""Longest marked span: ten minutes."""
MAX_TEXT: Final = 200
MAX_FILE: Final = 256 * 1024
"""Largest file of marks. Further marks are refused, so that it can always be read again."""


@dataclass(frozen=True)
class Mark:
    """A marked span. Times are in ns since the Unix epoch; `to_ns` is outside.

    reason: why it was marked;  by: what marked it;  at_ns: when
    """

    name: str
    from_ns: int
    to_ns: int
    reason: str
    by: str
    at_ns: int

    def __post_init__(self) -> None:
        """Raises SettingsError for values that are not allowed."""
        if not is_name(self.name):
            raise SettingsError("a mark's name has 1 to 64 of A-Z a-z 0-9 _ . -", "name")
        if not 0 <= self.from_ns < self.to_ns < 2**63 or self.to_ns - self.from_ns > MAX_MARK_NS:
            raise SettingsError(f"a mark covers more than 0 and at most {MAX_MARK_NS // 10**9} s", "to")
        if len(self.reason) > MAX_TEXT or len(self.by) > MAX_TEXT:
            raise SettingsError(f"a reason has at most {MAX_TEXT} characters", "reason")


class Marks:
    """The marks of one stream. Thread-safe: their tuple is replaced, never changed.

    path: their file;  damaged: whether it could not be read. Then everything counts as marked.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.damaged = path, False
        self._all: tuple[Mark, ...] = ()
        try:
            with open_regular(path) as file:
                told = read_object(file.read(MAX_FILE + 1), MAX_FILE)
            self._all = tuple(_mark_of(one) for one in told["marks"])
        except FileNotFoundError:
            pass
        except (OSError, JsonRefusedError, LidarCodecError, KeyError, TypeError):
            self.damaged = True

    def __iter__(self) -> Any:
        return iter(self._all)

    def __len__(self) -> int:
        return len(self._all)

    def add(self, mark: Mark, *, own: bool = True, instead_of: Sequence[Mark] = ()) -> None:
        """Add a mark, or replace the one of this name. It survives a power failure from then on.

        own: whether the vehicle itself set it;  instead_of: marks that are released in the same step

        Raises SettingsError if there are too many or their texts too long, SourceError if the file cannot be written.
        """
        others = [one for one in self.without(instead_of) if one.name != mark.name]
        share = 1.0 if own else OF_OTHERS
        if len(others) >= (most := int(share * MAX_MARKS)):
            raise SettingsError(f"there are {most} marks, which is the limit: release some first", "mark")
        self._store((*others, mark), int(share * MAX_FILE))

    def release(self, name: str) -> bool:
        """Remove a mark. Returns whether there was one. Raises SourceError if the file cannot be written."""
        left = tuple(one for one in self._all if one.name != name)
        if len(left) == len(self._all):
            return False
        self._store(left)
        return True

    def covers(self, begin_ns: int, end_ns: int) -> bool:
        """Whether a part of this span is marked."""
        return self.damaged or covered(self._all, begin_ns, end_ns)

    def without(self, marks: Sequence[Mark]) -> tuple[Mark, ...]:
        """All marks but these."""
        return tuple(one for one in self._all if one not in marks)

    def _store(self, marks: tuple[Mark, ...], most: int = MAX_FILE) -> None:
        if self.damaged:
            raise SourceError(f"{self.path.name} cannot be read: repair or remove it")
        text = json.dumps({"format": 1, "marks": [asdict(one) for one in marks]})
        if len(text) > most and len(marks) >= len(self._all):
            raise SettingsError("the marks have too much text: release some first, or give shorter reasons", "mark")
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            with written_whole(self.path) as beside:
                beside.write_text(text, "utf-8")
        except (OSError, SettingsError) as error:
            raise SourceError(f"the marks cannot be stored: {error}") from None
        self._all = marks


def covered(marks: Iterable[Mark], begin_ns: int, end_ns: int) -> bool:
    """Whether a part of a span is in one of these marks."""
    return any(one.from_ns < end_ns and one.to_ns > begin_ns for one in marks)


def _mark_of(told: Any) -> Mark:
    """Raises KeyError, TypeError, SettingsError."""
    times = [told[name] for name in ("from_ns", "to_ns", "at_ns")]
    if not all(isinstance(value, int) and not isinstance(value, bool) for value in times):
        raise TypeError("a time is not a whole number")
    from_ns, to_ns, at_ns = times
    return Mark(str(told["name"]), from_ns, to_ns, str(told["reason"]), str(told["by"]), at_ns)

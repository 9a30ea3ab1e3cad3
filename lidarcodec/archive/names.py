"""Names and ids of the objects in an archive.

| name | what |
|---|---|
| `plans/NAME-INPUT-ORIGIN-N.json` | how an input is cut into N segments |
| `recordings/VEHICLE/SENSOR/SEGMENT-HASH.mcap` | a recording |
| `frames/VEHICLE/SENSOR/SEGMENT-HASH.parquet` | a row for each of its frames |
| `commits/VEHICLE/SENSOR/FIRST-LAST-ORIGIN-SEGMENT.json` | makes both visible |
| `aside/ORIGIN-SEGMENT.json` | an input or a segment that was set aside, with the reason |
| `verified/SEGMENT-LISTED.json` | that the job `verify` found it whole, without its input |
| `verified/SEGMENT-LISTED-compared.json` | the same, compared with its input |

NAME is a hash of an input's name, INPUT one of its name and its contents as listed (size, tag, files beside it), ORIGIN
one of INPUT and the settings, SEGMENT one of ORIGIN and the range, HASH one of the recording's bytes, LISTED one of its
name, size and tag. A listing of
commits says which segments exist, when they begin and end, and what they come from: an input with settings, or, after
`recompress`, another segment.
"""

from __future__ import annotations

import hashlib
import json
import re
from typing import Any, Final, NamedTuple

from lidarcodec.settings import is_name

FORMAT: Final = 1
"""Version of the archive's objects. It is part of every id."""
_ID: Final = 24
"""Characters of an id: 96 bits."""
_COMMIT: Final = re.compile(
    r"commits/(?P<vehicle>[^/]+)/(?P<sensor>[^/]+)/(?P<first>\d{20})-(?P<last>\d{20})-(?P<origin>[0-9a-f]{24})"
    r"-(?P<segment>[0-9a-f]{24})\.json",
    re.ASCII,
)
_RECORDING: Final = re.compile(r"recordings/[^/]+/[^/]+/(?P<segment>[0-9a-f]{24})-[0-9a-f]{16}\.mcap")
_PART: Final = re.compile(r"frames/[^/]+/[^/]+/(?P<segment>[0-9a-f]{24})-[0-9a-f]{16}\.parquet")
_NOTE: Final = re.compile(r"verified/(?P<segment>[0-9a-f]{24})(-[0-9a-f]{24})?(-compared)?\.json")
_PLAN: Final = re.compile(r"plans/([0-9a-f]{24})-([0-9a-f]{24})-([0-9a-f]{24})-(\d{1,9})\.json", re.ASCII)
_IDS: Final = re.compile(r"[0-9a-f]{24}")


def id_of(*parts: Any) -> str:
    """The id of plain values: equal for equal values, on every machine.

    >>> id_of("a", 1) == id_of("a", 1), len(id_of("a"))
    (True, 24)
    """
    return hashlib.sha256(json_of([FORMAT, *parts])).hexdigest()[:_ID]


def json_of(value: Any) -> bytes:
    """Canonical JSON: equal values give equal bytes."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), ensure_ascii=True, allow_nan=False).encode()


class Commit(NamedTuple):
    """A segment in the archive, by the name of its commit. first_ns, last_ns: stamps of its first and last frame"""

    vehicle: str
    sensor: str
    first_ns: int
    last_ns: int
    origin: str
    segment: str

    @property
    def name(self) -> str:
        """Name of the object."""
        span = f"{max(0, self.first_ns):020}-{max(0, self.last_ns):020}"
        return f"commits/{self.vehicle}/{self.sensor}/{span}-{self.origin}-{self.segment}.json"


def commit_of(name: str) -> Commit | None:
    """The commit of that name; None for another object."""
    found = _COMMIT.fullmatch(name)
    if found is None or not is_name(found["vehicle"]) or not is_name(found["sensor"]):
        return None
    return Commit(
        found["vehicle"], found["sensor"], int(found["first"]), int(found["last"]), found["origin"], found["segment"]
    )


def recorded_segment(name: str) -> str | None:
    """The segment of a recording; None for another object."""
    found = _RECORDING.fullmatch(name)
    return None if found is None else found["segment"]


def part_segment(name: str) -> str | None:
    """The segment of a table of frames; None for another object."""
    found = _PART.fullmatch(name)
    return None if found is None else found["segment"]


def notes_of(segment: str, listed: str) -> tuple[str, str]:
    """Names of what the job `verify` notes of a segment: that it can be read, and that it is what its input holds.

    listed: the id of its recording as it was listed then, so that a note says nothing of one that changed
    """
    return f"verified/{segment}-{listed}.json", f"verified/{segment}-{listed}-compared.json"


def segment_of_note(name: str) -> str | None:
    """The segment of such a note; None for another object."""
    found = _NOTE.fullmatch(name)
    return None if found is None else found["segment"]


class PlanName(NamedTuple):
    """An input that was cut with settings, by the name of its plan.

    name: id of its name;  input: id of its name and contents;  origin: id of these and the settings
    segments: number of its segments
    """

    name: str
    input: str
    origin: str
    segments: int

    @property
    def object(self) -> str:
        """Name of the object."""
        return f"plans/{self.name}-{self.input}-{self.origin}-{self.segments}.json"


def plan_of(name: str) -> PlanName | None:
    """The plan of that name; None for another object."""
    found = _PLAN.fullmatch(name)
    return None if found is None else PlanName(found[1], found[2], found[3], int(found[4]))


def is_id(text: str) -> bool:
    """Whether a text is the id of something."""
    return _IDS.fullmatch(text) is not None

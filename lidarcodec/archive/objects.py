"""Objects of an archive that are read back: commits, plans, joined tables. Their contents are checked before use."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Final, NamedTuple

from lidarcodec.archive.names import FORMAT, Commit, is_id
from lidarcodec.archive.segments import MAX_FRAMES, Segment
from lidarcodec.archive.stores.base import Entry, Store, check_name
from lidarcodec.errors import SourceError
from lidarcodec.settings import is_name
from lidarcodec.untrusted.json import read_object
from lidarcodec.wire.header import MAX_MESSAGE

MAX_COMMIT: Final = 16 << 20
"""Largest commit that is read, in bytes."""
MAX_PLAN: Final = 64 << 20
"""Largest plan that is read, in bytes."""
MAX_JOINED: Final = 1 << 20
"""Largest list of the segments in a joined table, in bytes."""
_MAX_BYTES: Final = 1 << 50
_MAX_M: Final = 1e9
_MAX_NS: Final = 1 << 63


class Place(NamedTuple):
    """A message in a recording.

    stamp_ns: of its first frame;  offset, length: of its bytes;  checksum: its CRC-32C;  frame: number of
    its first frame;  frames: how many it has;  key: 1 for a key message, otherwise 0;  needs: the frame that it refers
    to, -1 for none
    """

    stamp_ns: int
    offset: int
    length: int
    checksum: int
    frame: int
    frames: int
    key: int
    needs: int


_LIMITS: Final = Place(_MAX_NS, _MAX_BYTES, MAX_MESSAGE, (1 << 32) - 1, _MAX_NS, MAX_FRAMES, 1, _MAX_NS)
_LEAST: Final = Place(0, 0, 1, 0, 0, 1, 0, -1)


def read_commit(store: Store, commit: Commit) -> dict[str, Any]:
    """The contents of a commit. Raises SourceError if it is damaged, OSError."""
    with _damaged(store, commit.name):
        value = read_object(store.read_small(commit.name, MAX_COMMIT), MAX_COMMIT)
        if value["format"] != FORMAT or value["segment"] != commit.segment:
            raise ValueError("it is of another format or segment")
        for key, folder in (("object", "recordings"), ("table", "frames")):
            if not check_name(_text(value[key])).startswith(f"{folder}/{commit.vehicle}/{commit.sensor}/"):
                raise ValueError(f"its {key} is in another place")
        for key, most in (("bytes", _MAX_BYTES), ("frames", MAX_FRAMES), ("packets", 1 << 40)):
            _number(value[key], most, key)
        for key in ("bound_m", "error_m"):
            if value[key] is not None and not 0 <= _real(value[key]) <= _MAX_M:
                raise ValueError(f"its {key} is out of range")
        _text(value["sha256"])
        if not isinstance(value["settings"], dict):
            raise TypeError("its settings are of another type")
        places = places_of(value)
        if (frames := sum(place.frames for place in places)) > MAX_FRAMES:
            raise ValueError(f"it has more than {MAX_FRAMES:,} frames")
        if frames < value["frames"]:
            raise ValueError(f"its messages have only {frames:,} of {value['frames']:,} frames")
        end = 0
        for place in places:
            if place.offset < end:
                raise ValueError("a message overlaps the one before it")
            end = place.offset + place.length
        if end > value["bytes"]:
            raise ValueError("a message lies beyond the end of the recording")
        if value["job"] == "compress":
            _check_input(value)
        return value


def places_of(value: dict[str, Any]) -> list[Place]:
    """The messages of a commit's recording, in order. Raises ValueError or TypeError if a number is out of range."""
    places = [Place._make(one) for one in value["messages"]]
    for place in places:
        for name, number, least, most in zip(Place._fields, place, _LEAST, _LIMITS, strict=True):
            _number(number, most, name, least)
    return places


def read_plan(store: Store, name: str) -> dict[str, Any]:
    """The contents of a plan. Raises SourceError if it is damaged, OSError."""
    with _damaged(store, name):
        value = read_object(store.read_small(name, MAX_PLAN), MAX_PLAN)
        for key in ("vehicle", "sensor"):
            if not is_name(_text(value[key])):
                raise ValueError(f"its {key} has no valid name")
        for key in ("not_kept", "lost"):
            if value[key] is not None:
                _text(value[key])
        for one in value["segments"]:
            Segment.of(one)
        return value


def read_joined(store: Store, name: str, size: int) -> list[str]:
    """The segments in a joined table, by the name of their list. size: bytes of the table

    Raises SourceError if it is damaged, or the table has another size, OSError.
    """
    with _damaged(store, name):
        value = read_object(store.read_small(name, MAX_JOINED), MAX_JOINED)
        segments = value["segments"]
        if value["bytes"] != size:
            raise ValueError("its table has another size than it says")
        if not isinstance(segments, list) or not all(isinstance(one, str) and is_id(one) for one in segments):
            raise ValueError("it has no list of segments")
        return segments


@contextmanager
def _damaged(store: Store, name: str) -> Iterator[None]:
    """Errors of contents as SourceError with the name of the object."""
    try:
        yield
    except (ValueError, KeyError, TypeError, AttributeError, SourceError) as error:
        what = f"it has no {error}" if isinstance(error, KeyError) else str(error)
        raise SourceError(f"{store.url}: {name} is damaged: {what}") from None


def _check_input(value: dict[str, Any]) -> None:
    Segment.of(value["range"])
    entries = [Entry(*one) for one in value["beside"]]
    entries.append(Entry(value["input"], value["input_size"], value["input_tag"]))
    for entry in entries:
        check_name(_text(entry.name).rstrip("/"))
        _number(entry.size, _MAX_BYTES, "size")
        _text(entry.tag)


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise TypeError("a text is of another type")
    return value


def _real(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError("a number is of another type")
    return value


def _number(value: Any, most: int, name: str, least: int = 0) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or not least <= value <= most:
        raise ValueError(f"{name} is not a whole number from {least} to {most}")
    return value

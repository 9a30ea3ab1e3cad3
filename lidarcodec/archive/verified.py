"""What the job `verify` found whole before, by two listings. A recording that changed since is looked at again."""

from __future__ import annotations

from typing import Any

from lidarcodec.archive.names import Commit, id_of, notes_of, recorded_segment
from lidarcodec.archive.stores.base import Entry, Store


class Verified:
    """Notes of an archive, and how its recordings are listed now: by name, size and tag."""

    def __init__(self, store: Store) -> None:
        """Raises OSError."""
        found: dict[str, list[Entry]] = {}
        for entry in store.entries("recordings/"):
            if (segment := recorded_segment(entry.name)) is not None:
                found.setdefault(segment, []).append(entry)
        self._listed = {segment: id_of("listed", [list(one) for one in entries]) for segment, entries in found.items()}
        self._notes = {entry.name for entry in store.entries("verified/")}

    def compared(self, commit: Commit) -> bool:
        """Whether a segment was compared with its input, with the recording that is there now."""
        return self._has(commit, 1)

    def choice(self, commit: Commit) -> dict[str, Any]:
        """Values for the task of a segment."""
        return {"listed": self._listed.get(commit.segment), "noted": self._has(commit, 0)}

    def _has(self, commit: Commit, which: int) -> bool:
        listed = self._listed.get(commit.segment)
        return listed is not None and notes_of(commit.segment, listed)[which] in self._notes

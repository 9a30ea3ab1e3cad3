"""Plan: the pieces that a clip consists of, as the vehicle listed them. It is stored, so that a fetch can go on."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from lidarcodec.errors import LidarCodecError, SettingsError, SourceError
from lidarcodec.files.piece_store import NAME
from lidarcodec.files.regular import open_regular
from lidarcodec.files.whole import written_whole
from lidarcodec.recording.pieces import MAX_PIECE, Piece
from lidarcodec.transport.keys import StreamKeys
from lidarcodec.untrusted.json import JsonRefusedError, read_object

MAX_CLIP_NS: Final = 3600 * 10**9
"""Longest clip: one hour."""
MAX_PIECES: Final = 20_000
MAX_FILE: Final = 8 * 2**20
GAP_NS: Final = 10**9
"""Shorter breaks between pieces are no gap: a frame may take so long."""


@dataclass(frozen=True)
class Clip:
    """What is wanted: a span of a stream. Times are in ns since the Unix epoch; `to_ns` is outside."""

    keys: StreamKeys
    from_ns: int
    to_ns: int

    def __post_init__(self) -> None:
        """Raises SettingsError if there is no such span."""
        if not 0 <= self.from_ns < self.to_ns < 2**63:
            raise SettingsError(
                "the clip must end after it begins: give a time for `to` that is later than that of `from`", "to"
            )
        if self.to_ns - self.from_ns > MAX_CLIP_NS:
            raise SettingsError(f"a clip has at most {MAX_CLIP_NS // 10**9} s: fetch several", "to")


@dataclass
class Plan:
    """The pieces of a clip, in order of time.

    listed: whether these are all;  gone: names of pieces that the vehicle did not keep long enough
    """

    clip: Clip
    pieces: list[Piece] = field(default_factory=list)
    listed: bool = False
    gone: set[str] = field(default_factory=set)

    def add(self, told: Iterable[Any]) -> int:
        """Add pieces that a vehicle listed. Returns how many were new.

        Raises SourceError for an answer that makes no sense.
        """
        known = {piece.name for piece in self.pieces}
        named = {piece.name: piece for piece in map(piece_of, told) if piece.name not in known}  # each name once
        fresh = [piece for piece in named.values() if piece.overlaps(self.clip.from_ns, self.clip.to_ns)]
        if len(known) + len(fresh) > MAX_PIECES:
            raise SourceError(f"the clip has more than {MAX_PIECES} pieces: fetch a shorter one")
        self.pieces = sorted((*self.pieces, *fresh), key=lambda one: (one.begin_ns, one.name))
        return len(fresh)

    @property
    def there(self) -> list[Piece]:
        """Pieces that are not gone."""
        return [piece for piece in self.pieces if piece.name not in self.gone]

    def gaps(self) -> list[tuple[int, int]]:
        """Spans of the clip without frames."""
        at, found, lost = self.clip.from_ns, [], False
        for piece in self.pieces:
            if piece.name in self.gone:
                lost = True
                continue
            if piece.begin_ns > at and (lost or piece.begin_ns - at > GAP_NS):
                found.append((at, piece.begin_ns))
            at, lost = max(at, piece.end_ns), False
        left_ns = self.clip.to_ns - at
        return found + [(at, self.clip.to_ns)] * (left_ns > GAP_NS or (lost and left_ns > 0))

    def store(self, path: Path) -> None:
        """Write it to a file. Raises SourceError."""
        told = {
            "format": 1,
            "pieces": [piece.about() for piece in self.pieces],
            "listed": self.listed,
            "gone": sorted(self.gone),
        }
        try:
            path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
            with written_whole(path, private=True) as beside:
                beside.write_text(json.dumps(told, separators=(",", ":")), "utf-8")
        except (OSError, SettingsError) as error:
            raise SourceError(f"the plan of the clip cannot be stored: {error}") from None

    @classmethod
    def read(cls, path: Path, clip: Clip) -> Plan:
        """The plan in a file; an empty one if there is none, or it is damaged."""
        plan = cls(clip)
        try:
            with open_regular(path) as file:
                told = read_object(file.read(MAX_FILE + 1), MAX_FILE)
            plan.add(told["pieces"])
            plan.gone = {str(name) for name in told["gone"]}
            plan.listed = told["listed"] is True
        except (OSError, JsonRefusedError, LidarCodecError, KeyError, TypeError):
            return cls(clip)
        return plan


def piece_of(told: Any) -> Piece:
    """A piece that a vehicle listed, after a check.

    Raises SourceError if a field is missing or out of range.
    """
    limits = {"begin_ns": 2**63, "end_ns": 2**63, "size": MAX_PIECE + 1, "frames": 2**31}
    if isinstance(told, dict) and isinstance(told.get("name"), str) and NAME.fullmatch(told["name"]):
        values = [
            value
            for name, limit in limits.items()
            if isinstance(value := told.get(name), int) and not isinstance(value, bool) and 0 <= value < limit
        ]
        if len(values) == len(limits):
            begin_ns, end_ns, size, frames = values
            piece = Piece(told["name"], begin_ns, end_ns, size, frames)
            if piece.begin_ns <= piece.end_ns and piece.size:
                return piece
    raise SourceError("the vehicle's list of pieces cannot be understood")

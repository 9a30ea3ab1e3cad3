"""Clips: the folder of fetches and of the clips that they brought. The folder is the only record of them.

Each fetch has a folder of its own, named by its id. In it, `about.json` says what is wanted and how it stands,
`plan.json` which pieces that takes, and `clip.mcap` is the clip once it is complete. Pieces on their way are in the
folder `pieces`.
"""

from __future__ import annotations

import json
import logging
import re
import secrets
import shutil
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final, Literal, get_args

from lidarcodec.apps.past.plan import Clip, Plan
from lidarcodec.errors import LidarCodecError, SettingsError, SourceError
from lidarcodec.files.piece_store import PieceStore
from lidarcodec.files.regular import open_regular
from lidarcodec.files.whole import written_whole
from lidarcodec.recording.pieces import Piece, pieces_in, read_piece
from lidarcodec.transport.keys import StreamKeys
from lidarcodec.untrusted.json import JsonRefusedError, read_object
from lidarcodec_server.holding import Hold

logger = logging.getLogger(__name__)

State = Literal["running", "complete", "failed", "cancelled"]
ID: Final = re.compile(r"[0-9]{8}T[0-9]{6}Z-[0-9a-f]{6}")
MAX_ABOUT: Final = 64 * 1024
MAX_LISTED: Final = 10_000
SHARES: Final = 4
"""The clips of marks of one vehicle, which are not deleted to make room, may take so small a part of all."""
MAX_STAYING: Final = 256
"""Most such clips of one vehicle."""
MAX_GAPS: Final = 64
"""Most gaps in the record of a clip."""


@dataclass(frozen=True)
class Record:
    """A fetch. Times are in ns since the Unix epoch; ended_ns is None while it runs. size: bytes of its clip

    reason: why it failed;  by: who asked for it;  stays: whether its clip is not deleted to make room
    gaps:   spans that its clip lacks, in order of time, because the vehicle did not keep them
    missing: frames that are missing between those of its clip; None: not known
    """

    id: str
    clip: Clip
    state: State
    by: str
    started_ns: int
    ended_ns: int | None = None
    reason: str | None = None
    size: int = 0
    stays: bool = False
    gaps: tuple[tuple[int, int], ...] = ()
    missing: int | None = None

    def spans(self) -> list[tuple[int, int]]:
        """What its clip has: its span without the gaps."""
        at, found = self.clip.from_ns, []
        for begin, end in self.gaps:
            found.append((at, begin))
            at = end
        return [(begin, end) for begin, end in (*found, (at, self.clip.to_ns)) if begin < end]

    def about(self) -> dict[str, Any]:
        """The content of its `about.json`."""
        clip = self.clip
        return {
            "format": 1,
            "vehicle": clip.keys.vehicle,
            "sensor": clip.keys.sensor,
            "from_ns": clip.from_ns,
            "to_ns": clip.to_ns,
            "state": self.state,
            "by": self.by,
            "started_ns": self.started_ns,
            "ended_ns": self.ended_ns,
            "reason": self.reason,
            "size": self.size,
            "stays": self.stays,
            "gaps": [list(gap) for gap in self.gaps],
            "missing": self.missing,
        }


def oldest_first(records: list[Record]) -> list[Record]:
    """Clips in the order in which they were asked for."""
    return sorted(records, key=lambda one: one.started_ns)


def largest_vehicles_first(vehicle: str, plan: Plan, done: list[Record], records: list[Record]) -> list[Record]:
    """Which clips may give way to one that only a vehicle's mark asks for: always the oldest of the vehicle whose clips
    take most, as long as they take more than those of this vehicle would.

    vehicle, plan: of the new clip;  done: all clips;  records: those that may be deleted
    """
    has = Counter({vehicle: _bytes(plan)})
    for one in done:
        has[one.clip.keys.vehicle] += one.size
    left: dict[str, list[Record]] = {}
    for one in reversed(oldest_first(records)):
        left.setdefault(one.clip.keys.vehicle, []).append(one)
    found: list[Record] = []
    while left:
        most = max(left, key=lambda name: (has[name], name == vehicle, -left[name][-1].started_ns))
        if most != vehicle and has[most] <= has[vehicle]:
            break
        found.append(left[most].pop())
        has[most] -= found[-1].size
        if not left[most]:
            del left[most]
    return found


def _bytes(plan: Plan) -> int:
    return sum(piece.size for piece in plan.there)


class Clips:
    """Reads and writes the folder. Methods wait for the disk: call them from a thread.

    Raises SourceError if the folder cannot be used.
    """

    def __init__(self, folder: Path, max_bytes: int) -> None:
        self.folder, self.max_bytes = folder, max_bytes
        self.store = PieceStore(folder / "pieces")
        self._hold: Hold | None = None

    def claim(self) -> None:
        """Have the folder for this server alone, until it is given back or the process ends.

        Raises SourceError if another server has it.
        """
        if self._hold is not None:
            return
        try:
            self.folder.mkdir(0o700, parents=True, exist_ok=True)
            self._hold = Hold.of(self.folder, alone=True, wait_s=0.0)
        except OSError:  # then it cannot be written, either, and what is here can still be read
            return
        if self._hold is None:
            raise SourceError("another server uses the folder of clips: start one of them with --past DIR")

    def give_back(self) -> None:
        """Let another server have the folder."""
        if self._hold is not None:
            self._hold.close()
            self._hold = None

    def records(self) -> list[Record]:
        """All fetches, oldest first. A folder that is damaged is left out."""
        try:
            names = sorted(path.name for path in self.folder.iterdir() if ID.fullmatch(path.name))
        except FileNotFoundError:
            return []
        except OSError as error:
            raise self._unusable(error) from None
        return [record for name in names[-MAX_LISTED:] if (record := self._read(name)) is not None]

    def create(self, clip: Clip, by: str, now_ns: int, *, stays: bool) -> Record:
        """A new fetch, on the disk."""
        stamp = datetime.fromtimestamp(now_ns // 10**9, UTC).strftime("%Y%m%dT%H%M%SZ")
        record = Record(f"{stamp}-{secrets.token_hex(3)}", clip, "running", by, now_ns, stays=stays)
        try:
            (self.folder / record.id).mkdir(parents=True, mode=0o700)
        except OSError as error:
            raise self._unusable(error) from None
        self.write(record)
        return record

    def write(self, record: Record) -> None:
        """Store the state of a fetch. It survives a power failure from then on."""
        try:
            with written_whole(self.folder / record.id / "about.json", private=True) as beside:
                beside.write_text(json.dumps(record.about()), "utf-8")
        except (OSError, SettingsError) as error:
            raise SourceError(f"the folder of clips cannot be used: {error}") from None

    def with_clip(self, record: Record) -> Record:
        """The record of a fetch; complete if its clip is here, though that could not be stored, as on a full disk."""
        if record.state != "running":
            return record
        plan = Plan.read(self.plan_file(record), record.clip)
        try:
            found = self.clip_file(record).stat()
        except OSError:
            return record
        if not plan.listed:
            return record
        return replace(record, state="complete", size=found.st_size, gaps=few(plan.gaps()), ended_ns=found.st_mtime_ns)

    def plan_file(self, record: Record) -> Path:
        """Where the plan of a fetch is stored."""
        return self.folder / record.id / "plan.json"

    def clip_file(self, record: Record) -> Path:
        """The recording that a fetch brought, if it is complete."""
        return self.folder / record.id / "clip.mcap"

    def remove(self, record: Record) -> None:
        """Delete a fetch and its clip."""
        shutil.rmtree(self.folder / record.id, ignore_errors=True)

    def forget_pieces(self, plan: Plan, others: list[Plan]) -> None:
        """Delete the pieces of a plan that no other plan needs."""
        needed = {piece.name for other in others for piece in other.pieces}
        self.store.forget(piece.name for piece in plan.pieces if piece.name not in needed)

    def take_from_clips(self, plan: Plan, done: list[Record]) -> None:
        """Take pieces of a plan out of clips that are here, so that they are not fetched again."""
        lacking = {piece.name for piece in plan.there if not self.store.has(piece.name, piece.size)}
        for record in done:
            clip = record.clip
            if not lacking:
                return
            if clip.keys != plan.clip.keys or clip.to_ns < plan.clip.from_ns or clip.from_ns > plan.clip.to_ns:
                continue
            path = self.clip_file(record)
            try:
                for piece in pieces_in(path):
                    if piece.name in lacking:
                        self.store.add(piece.name, 0, read_piece(path, piece))
                        self.store.finish(piece.name)
                        lacking.discard(piece.name)
            except (OSError, LidarCodecError) as error:
                logger.warning("the clip of fetch %s cannot be read: %s", record.id, error)

    def make_room(
        self,
        plans: list[Plan],
        done: list[Record],
        forget: Callable[[Record], bool],
        first: Callable[[list[Record]], list[Record]] = oldest_first,
    ) -> None:
        """Delete clips until there is room for plans, once as pieces and once as clips.
        If that is not enough, none is deleted.

        forget: asked before a clip is deleted; false if somebody reads it, so that it stays
        first:  which of the clips may be deleted, in what order
        Raises SourceError if that is not enough.
        """
        needed = sum(2 * piece.size - self._here(piece) for plan in plans for piece in plan.there)
        total = sum(path.stat().st_size for path in self.store.folder.glob("*")) if self.store.folder.is_dir() else 0
        over = total + needed + sum(record.size for record in done) - self.max_bytes
        going = first([record for record in done if not record.stays])
        if over <= sum(record.size for record in going):
            for record in going:
                if over <= 0:
                    break
                if forget(record):
                    self.remove(record)
                    over -= record.size
                    logger.warning("the clip of fetch %s was deleted: the folder of clips is full", record.id)
        if over > 0:
            raise SourceError(f"the clip is too large: all clips together may take {self.max_bytes // 2**20} MiB")

    def check_share(self, record: Record, plan: Plan, done: list[Record]) -> None:
        """Raises SourceError if a clip that stays would take more than one vehicle may have of the room for all, or
        there would be too many."""
        vehicle = record.clip.keys.vehicle
        staying = [one.size for one in done if one.stays and one.clip.keys.vehicle == vehicle]
        if record.stays and sum(staying) + _bytes(plan) > self.max_bytes // SHARES:
            raise SourceError(
                f"the clips of marks of {vehicle} take all that one vehicle may have, a quarter of the room for clips: "
                "cancel some of them"
            )
        if record.stays and len(staying) >= MAX_STAYING:
            raise SourceError(f"{vehicle} has {MAX_STAYING} clips of marks, which is the limit: cancel some of them")

    def _here(self, piece: Piece) -> int:
        """Bytes of a piece that are in the folder already."""
        return piece.size if self.store.has(piece.name, piece.size) else self.store.got(piece.name)

    def _read(self, name: str) -> Record | None:
        try:
            with open_regular(self.folder / name / "about.json") as file:
                told = read_object(file.read(MAX_ABOUT + 1), MAX_ABOUT)
            numbers = [told[field] for field in ("from_ns", "to_ns", "started_ns", "size")]
            if told["state"] not in get_args(State) or not all(isinstance(value, int) for value in numbers):
                return None
            from_ns, to_ns, started_ns, size = numbers
            clip = Clip(StreamKeys(told["vehicle"], told["sensor"]), from_ns, to_ns)
            ended_ns, reason = told["ended_ns"], told["reason"]
            return Record(
                name,
                clip,
                told["state"],
                str(told["by"]),
                started_ns,
                ended_ns if isinstance(ended_ns, int) else None,
                None if reason is None else str(reason),
                size,
                told["stays"] is True,
                self._gaps(name, told, clip),
                missing if isinstance(missing := told.get("missing"), int) else None,
            )
        except (OSError, JsonRefusedError, LidarCodecError, KeyError, TypeError, ValueError, OverflowError):
            return None

    def _gaps(self, name: str, told: dict[str, Any], clip: Clip) -> tuple[tuple[int, int], ...]:
        """Gaps as they are stored. A clip from before they were stored has a plan, which says the same.

        Raises TypeError, ValueError.
        """
        if told["state"] != "complete":
            return ()
        if "gaps" not in told:
            return few(Plan.read(self.folder / name / "plan.json", clip).gaps())
        gaps = few([(int(begin), int(end)) for begin, end in told["gaps"]])
        edges = [clip.from_ns, *(edge for gap in gaps for edge in gap), clip.to_ns]
        if sorted(edges) != edges:
            raise ValueError("gaps are outside of the clip, or not in order")
        return gaps

    def _unusable(self, error: OSError) -> SourceError:
        return SourceError(f"the folder of clips cannot be used: {error.strerror or error}")


def few(gaps: list[tuple[int, int]]) -> tuple[tuple[int, int], ...]:
    """Gaps, in order of time. From the 64th on they are one, so that never too little counts as missing.

    >>> few([(2 * at, 2 * at + 1) for at in range(100)])[-1]
    (126, 199)
    """
    last = gaps[MAX_GAPS - 1 :]
    return (*gaps[: MAX_GAPS - 1], *([(last[0][0], last[-1][1])] if last else []))

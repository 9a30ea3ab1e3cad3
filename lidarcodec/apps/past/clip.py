"""Writes a fetched clip as a recording."""

from __future__ import annotations

from pathlib import Path
from typing import Final, NamedTuple

from lidarcodec import wire
from lidarcodec.apps.past.plan import Plan
from lidarcodec.apps.recorder import LOSSLESS
from lidarcodec.errors import DecodeError, SourceError
from lidarcodec.files.piece_store import PieceStore
from lidarcodec.message import Message
from lidarcodec.recording import RecordingWriter
from lidarcodec.recording.pieces import messages_in

STEP_NS: Final = 2 * 10**9
"""A clock may be set by so much within a piece."""


MAX_HOLES: Final = 1000
"""Most holes that are listed; all are counted."""


class Hole(NamedTuple):
    """Frames that are missing between two frames of a clip, by their numbers. Times: the stamps of those two, in ns"""

    from_ns: int
    to_ns: int
    frames: int


class Written(NamedTuple):
    """A clip: its bytes, and the frames that are in it, whatever the vehicle had listed.

    missing: frames that are missing between them;  holes: where, the first MAX_HOLES
    """

    bytes: int
    frames: int
    missing: int
    holes: tuple[Hole, ...]


def write_clip(plan: Plan, store: PieceStore, path: Path) -> Written:
    """Write the pieces of a plan to a recording at `path`.

    It begins with the first piece that reaches into the clip, so up to a second earlier, and ends as much later.
    Raises SourceError if a piece is missing or damaged, OSError.
    """
    clip, numbers = plan.clip, _Numbers()
    about = {"past": f"{clip.from_ns} to {clip.to_ns}", "gaps": str(len(plan.gaps()))}
    with path.open("wb") as file:
        with RecordingWriter(file, clip.keys.vehicle, clip.keys.sensor, LOSSLESS, about) as writer:
            for piece in plan.there:
                try:
                    for data in messages_in(store.read(piece.name)):
                        message = wire.unpack(data)
                        if not piece.begin_ns - STEP_NS <= message.stamp_ns <= piece.end_ns + STEP_NS:
                            raise SourceError("the vehicle kept messages of another time than it listed")
                        writer.write(data)
                        numbers.add(message)
                except DecodeError as error:
                    raise SourceError(f"the vehicle sent data that are not messages: {error}") from None
        return Written(file.tell(), numbers.frames, numbers.missing, tuple(numbers.holes))


class _Numbers:
    """Counts frames, and finds missing ones by their numbers. They begin again with each start of a sensor."""

    def __init__(self) -> None:
        self.frames = self.missing = 0
        self.holes: list[Hole] = []
        self._last: Message | None = None

    def add(self, message: Message) -> None:
        self.frames += message.frame_count
        last, self._last = self._last, message
        if last is None or last.stream_id != message.stream_id:
            return
        missing = message.frame_index - last.frame_index - last.frame_count
        if missing <= 0:
            return
        self.missing += missing
        if len(self.holes) < MAX_HOLES:
            self.holes.append(Hole(last.stamp_ns, message.stamp_ns, missing))

"""Writes a fetched clip as a recording."""

from __future__ import annotations

from pathlib import Path
from typing import Final, NamedTuple

from lidarcodec import wire
from lidarcodec.apps.past.plan import Plan
from lidarcodec.apps.recorder import LOSSLESS
from lidarcodec.errors import DecodeError, SourceError
from lidarcodec.evaluation.verify import promise_of
from lidarcodec.files.piece_store import PieceStore
from lidarcodec.recording import RecordingWriter
from lidarcodec.recording.holes import Hole, Numbers
from lidarcodec.recording.pieces import messages_in

STEP_NS: Final = 2 * 10**9
"""A clock may be set by so much within a piece."""


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
    Raises SourceError if a piece is missing or damaged, or its frames are not exact, OSError.
    """
    clip, numbers = plan.clip, Numbers()
    about = {"past": f"{clip.from_ns} to {clip.to_ns}", "gaps": str(len(plan.gaps()))}
    with path.open("wb") as file:
        with RecordingWriter(file, clip.keys.vehicle, clip.keys.sensor, LOSSLESS, about) as writer:
            for piece in plan.there:
                try:
                    for data in messages_in(store.read(piece.name)):
                        message = wire.unpack(data)
                        if not piece.begin_ns - STEP_NS <= message.stamp_ns <= piece.end_ns + STEP_NS:
                            raise SourceError("the vehicle kept messages of another time than it listed")
                        if message.width and not promise_of(message).identical:
                            raise SourceError("the vehicle sent frames that are not exact: a clip has exact ones only")
                        writer.write(data)
                        numbers.add(message)
                except DecodeError as error:
                    raise SourceError(f"the vehicle sent data that are not messages: {error}") from None
        return Written(file.tell(), numbers.frames, numbers.missing, tuple(numbers.holes))

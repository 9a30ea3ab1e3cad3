"""decoded: decodes the messages of a recording, with a limit of work in proportion to the size of the file.

A hostile file may repeat a message in a compressed chunk. Each copy has twenty bytes and takes a tenth of a second to
decode, so a megabyte would take hours. Recordings of lidarcodec never have so many returns for each byte (budgets.py).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Final, Protocol

from lidarcodec.budgets import DECODED_BASE, DECODED_PER_BYTE, Allowance
from lidarcodec.errors import DecodeError, MissingExtraError
from lidarcodec.frame import Frame
from lidarcodec.layers import SECTORS, RefinedFrame
from lidarcodec.layers import unpack as unpack_refinement
from lidarcodec.message import Message
from lidarcodec.recording.refinements import Refinements
from lidarcodec.sensors.images import MAX_CELLS
from lidarcodec.units import LASERS
from lidarcodec.wire import unpack

REFINED: Final = 2.0
"""The cost of refining a frame, as a multiple of the cost of decoding it."""
COLUMN: Final = 2
"""The cost of a column without returns, in returns."""
NUMBER: Final = 0.25
"""The cost of a number of a plane of another sensor than an HDL-64E, with or without a return, in returns."""


class Readable(Protocol):
    """A file that gives messages.

    size: its bytes;  refinements: those of messages that it gave, or will give soon
    leave_out_rest: counts and logs that the rest is not read
    """

    refinements: Refinements

    @property
    def size(self) -> int: ...

    def leave_out_rest(self, why: str) -> None: ...


def decoded(
    reader: Readable,
    messages: Iterable[tuple[int, bytes]],
    decode: Callable[[Message], list[Frame]],
    failed: Callable[[DecodeError], object],
    refined: Callable[[RefinedFrame], object] = lambda frame: None,
) -> Iterator[tuple[Message, list[Frame]]]:
    """Each message that can be decoded, with the frames that became complete with it. Frames have the refinements that
    the recording holds.

    It ends early if a file decodes to too much data; this is counted and logged as damage. The work is the sum of
    returns, columns and numbers of planes. A message that fails counts as a full frame, because it may fail at its very
    end.

    messages: from `reader`, with their times;  decode: decodes one message;  failed: called with each error
    refined: called with each frame that refinements were taken for
    Raises MissingExtraError at a message of a codec that is not installed.
    """
    allowed = Allowance(DECODED_BASE, DECODED_PER_BYTE)
    for _, data in messages:
        message = frames = None
        try:
            message = unpack(data)
            frames = decode(message)
        except MissingExtraError:  # not damage: the file can be decoded where the codec is installed
            raise
        except DecodeError as error:
            failed(error)
        cost = 0.0 if message is None else _cost(message, frames)
        if message is not None and frames is not None:
            if (parts := reader.refinements.take(message)) and len(frames) == 1:
                cost *= 1 + REFINED * max(1.0, len(parts) / SECTORS)
                frames = [_refined(message, frames[0], parts, failed, refined)]
            yield message, frames
        if message is not None and not allowed.spend(cost, reader.size):
            reader.leave_out_rest(f"it decodes to more than {DECODED_PER_BYTE} returns for each of its bytes")
            return


def _refined(
    message: Message,
    base: Frame,
    parts: list[bytes],
    failed: Callable[[DecodeError], object],
    refined: Callable[[RefinedFrame], object],
) -> Frame:
    """The frame with its refinements; those that cannot be used are passed to `failed`, and change nothing."""
    try:
        found = RefinedFrame(base, message)
    except DecodeError as error:
        failed(error)
        return base
    for data in parts:
        try:
            if found.add(unpack_refinement(data)):
                found.coded_bytes += len(data)
        except DecodeError as error:
            failed(error)
    refined(found)
    return found.frame()


def _cost(message: Message, frames: list[Frame] | None) -> float:
    """The work that a message was, in returns. frames: None if it failed."""
    if not message.planes:
        done = LASERS * message.width if frames is None else sum(frame.points for frame in frames)
        return COLUMN * message.width + done
    if frames is None:
        return NUMBER * MAX_CELLS
    return sum(frame.points + NUMBER * frame.range.size * (2 + len(frame.planes)) for frame in frames)

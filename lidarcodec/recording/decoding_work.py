"""decoded: decodes the messages of a recording, with a limit of work in proportion to the size of the file.

A hostile file may repeat a message in a compressed chunk. Each copy has twenty bytes and takes a tenth of a second to
decode, so a megabyte would take hours. Recordings of lidarcodec never have so many returns for each byte (budgets.py).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Final

from lidarcodec.budgets import DECODED_BASE, DECODED_PER_BYTE, Allowance
from lidarcodec.errors import DecodeError, MissingExtraError
from lidarcodec.frame import Frame
from lidarcodec.message import Message
from lidarcodec.recording.reader import RecordingReader
from lidarcodec.units import LASERS
from lidarcodec.wire import unpack

COLUMN: Final = 2
"""The cost of a column without returns, in returns."""


def decoded(
    reader: RecordingReader,
    messages: Iterable[tuple[int, bytes]],
    decode: Callable[[Message], list[Frame]],
    failed: Callable[[DecodeError], object],
) -> Iterator[tuple[Message, list[Frame]]]:
    """Each message that can be decoded, with the frames that became complete with it.

    It ends early if a file decodes to too much data; this is counted and logged as damage. The work is the sum of
    returns and columns. A message that fails counts as a full frame, because it may fail at its very end.

    messages: from `reader`, with their times;  decode: decodes one message;  failed: called with each error
    Raises MissingExtraError at a message of a codec that is not installed.
    """
    allowed = Allowance(DECODED_BASE, DECODED_PER_BYTE)
    for _, data in messages:
        width, frames = 0, None
        try:
            message = unpack(data)
            width = message.width
            frames = decode(message)
        except MissingExtraError:  # not damage: the file can be decoded where the codec is installed
            raise
        except DecodeError as error:
            failed(error)
        if frames is not None:
            yield message, frames
        cost = COLUMN * width + (LASERS * width if frames is None else sum(frame.points for frame in frames))
        if not allowed.spend(cost, reader.size):
            reader.leave_out_rest(f"it decodes to more than {DECODED_PER_BYTE} returns for each of its bytes")
            return

"""KeyChain: the queue of messages for one viewer: the newest ones, few, and only those that it can decode.

A message that refers to another message is useful only to a viewer that got the other one. So a viewer that falls
behind gets nothing until the next message that it can decode.
"""

from __future__ import annotations

import struct
from collections import OrderedDict
from typing import Final, NamedTuple

from lidarcodec import wire
from lidarcodec.errors import DecodeError
from lidarcodec.message import SectionType

PENDING: Final = 4
"""Most messages that wait for a viewer because each refers to the one before. With more it waits for a key message."""
REMEMBERED: Final = 256
_HASH_AT: Final = 1
_HASH_BYTES: Final = 8
_SECTION: Final = struct.Struct("<BBI")


class Coded(NamedTuple):
    """A message with some of its header fields (see `lidarcodec.message.Message`). calibration: hash of the sensor"""

    data: bytes
    stream_id: int
    codec: int
    key: bool
    first: int
    frames: int
    needs: int | None
    calibration: bytes
    stamp_ns: int


def coded(data: bytes) -> Coded:
    """Read the fields of a message. The receiver has checked it before.

    Raises DecodeError.
    """
    head = wire.peek(data)
    at, calibration = head.header_bytes, b""
    for _ in range(head.section_count):
        if at + _SECTION.size > len(data):
            raise DecodeError("a section of the message ends too early", at)
        kind, _, length = _SECTION.unpack_from(data, at)
        at += _SECTION.size
        if kind == SectionType.CALIBRATION:
            calibration = data[at + _HASH_AT : at + _HASH_AT + _HASH_BYTES]
            break
        at += length
    frames = (head.frame_index, head.frame_count)
    return Coded(data, head.stream_id, head.codec, head.key, *frames, head.needs, calibration, head.stamp_ns)


class KeyChain:
    """The messages that one viewer got, and those that wait for it.

    skipped: number of messages that it did not get;  lost: whether it waits for a key message
    """

    def __init__(self) -> None:
        self._of: tuple[int, int] | None = None
        self._calibrations: set[bytes] = set()
        self._given: OrderedDict[int, None] = OrderedDict()
        self._pending: list[Coded] = []
        self.skipped = 0
        self.lost = True

    def offer(self, message: Coded) -> bool:
        """Add a new message. False: this viewer needs a key message to continue."""
        alone = message.key or (message.needs is None and self._has(message))
        opened = None if alone or message.needs is not None else self._waiting_key(message)
        if alone or opened is not None:  # it needs none of the waiting messages, and is newer
            stay = [] if opened is None else [opened]
            self.skipped += len(self._pending) - len(stay)
            self._pending = [*stay, message]
            self.lost = False
            return True
        if not self.lost and self._follows(message):
            return True
        self.skipped += 1 + len(self._pending)
        self._pending.clear()
        self.lost = True
        return False

    def take(self) -> Coded | None:
        """The next message for the viewer; None if none waits."""
        if not self._pending:
            return None
        message = self._pending.pop(0)
        of = (message.stream_id, message.codec)
        if of != self._of:
            self._of = of
            self._calibrations.clear()
            self._given.clear()
        if message.key:
            self._calibrations.add(message.calibration)
        for index in range(message.first, message.first + message.frames):
            self._given[index] = None
        while len(self._given) > REMEMBERED:
            self._given.popitem(last=False)
        return message

    def _follows(self, message: Coded) -> bool:
        """Add a message if the viewer has its reference or will get it. Returns whether it was added."""
        waits = {index for one in self._pending for index in range(one.first, one.first + one.frames)}
        if message.needs in waits and len(self._pending) < PENDING:
            if self._has(message) or self._waiting_key(message) is not None:
                self._pending.append(message)
                return True
        elif message.needs in self._given and self._has(message):
            self.skipped += len(self._pending)
            self._pending = [message]
            return True
        return False

    def _has(self, message: Coded) -> bool:
        """Whether the viewer got a key message with this codec and this calibration."""
        return (message.stream_id, message.codec) == self._of and message.calibration in self._calibrations

    def _waiting_key(self, message: Coded) -> Coded | None:
        """The waiting key message to which this message refers."""
        keys = [one for one in self._pending if one.key]
        of = (message.stream_id, message.codec, message.calibration)
        fits = keys and (keys[-1].stream_id, keys[-1].codec, keys[-1].calibration) == of
        return keys[-1] if fits else None

"""KeyChain: of a stream's messages those that one viewer can decode, the newest ones, and few of them.

A message that refers to another one is of use only to a viewer that got that other one. So a viewer that falls behind
is taken off the stream until the next message that needs nothing it lacks.
"""

from __future__ import annotations

import struct
from collections import OrderedDict
from typing import Final, NamedTuple

from lidarcodec import wire
from lidarcodec.errors import DecodeError
from lidarcodec.message import SectionType

PENDING: Final = 4
"""Messages that wait for a viewer because they build on one another; more, and it waits for a key message instead."""
REMEMBERED: Final = 256
_HASH_AT: Final = 1
_HASH_BYTES: Final = 8
_SECTION: Final = struct.Struct("<BBI")


class Coded(NamedTuple):
    """A message, and what has to be known of it: see `lidarcodec.message.Message`; calibration: the sensor's hash."""

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
    """A message that was checked before.

    Raises DecodeError.
    """
    head = wire.peek(data)
    at, calibration = head.header_bytes, b""
    for _ in range(head.section_count):
        if at + _SECTION.size > len(data):
            raise DecodeError("a section that is cut", at)
        kind, _, length = _SECTION.unpack_from(data, at)
        at += _SECTION.size
        if kind == SectionType.CALIBRATION:
            calibration = data[at + _HASH_AT : at + _HASH_AT + _HASH_BYTES]
            break
        at += length
    frames = (head.frame_index, head.frame_count)
    return Coded(data, head.stream_id, head.codec, head.key, *frames, head.needs, calibration, head.stamp_ns)


class KeyChain:
    """What one viewer was given, and what waits for it.

    skipped: messages that it did not get;  lost: whether it waits for a key message
    """

    def __init__(self) -> None:
        self._of: tuple[int, int] | None = None
        self._calibrations: set[bytes] = set()
        self._given: OrderedDict[int, None] = OrderedDict()
        self._pending: list[Coded] = []
        self.skipped = 0
        self.lost = True

    def offer(self, message: Coded) -> bool:
        """Take a message that came. False: this viewer needs a key message to go on."""
        alone = message.key or (message.needs is None and self._has(message))
        opened = None if alone or message.needs is not None else self._waiting_key(message)
        if alone or opened is not None:  # it needs nothing of what waits, and is newer
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
        """The next message for the viewer; None when nothing waits."""
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
        """Take a message whose reference the viewer has, or is about to get; whether it could be taken."""
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
        """Whether the viewer was given a key message of this codec with this calibration."""
        return (message.stream_id, message.codec) == self._of and message.calibration in self._calibrations

    def _waiting_key(self, message: Coded) -> Coded | None:
        """The key message among those that wait that this one builds on."""
        keys = [one for one in self._pending if one.key]
        of = (message.stream_id, message.codec, message.calibration)
        fits = keys and (keys[-1].stream_id, keys[-1].codec, keys[-1].calibration) == of
        return keys[-1] if fits else None

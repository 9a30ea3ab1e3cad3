"""The protocol between a stream's process and its codec's process, over a socket pair: a head, then a body.

A head is 16 bytes: kind, flag, 2 spare bytes, number of parts, bytes of the body. Kinds below DONE are requests, the
others are answers; each request has one answer. Nothing is pickled: settings and errors are JSON, messages have the
wire format, and frames are arrays (see `frames`). Every size is checked before memory is allocated.
"""

from __future__ import annotations

import contextlib
import json
import socket
import struct
import time
from collections.abc import Sequence
from enum import IntEnum
from typing import Any, Final, NamedTuple

from lidarcodec import errors
from lidarcodec.errors import LidarCodecError
from lidarcodec.untrusted.json import JsonRefusedError, read_object
from lidarcodec.wire import MAX_MESSAGE

HEAD: Final = struct.Struct("<BB2xIQ")
MAX_TEXT: Final = 1 << 18
"""Most bytes of settings or of an error."""
MAX_BODY: Final = 512 * 2**20
"""Most bytes of the frames or messages in one answer."""
MESSAGE_SIZE: Final = struct.Struct("<I")
MAX_MESSAGES: Final = 1024
_PARTS: Final = 64
"""Most buffers in one call of the system."""


class Kind(IntEnum):
    """Kinds of requests and answers."""

    LOAD = 1
    OPEN_ENCODER = 2
    OPEN_DECODER = 3
    ENCODE = 4
    APPLY = 5
    DECODE = 6
    FLUSH = 7
    DONE = 32
    MESSAGES = 33
    FRAMES = 34
    FAILED = 35


class Head(NamedTuple):
    """flag: a truth value; number: messages or frames in the body; size: bytes of the body"""

    kind: int
    flag: bool
    number: int
    size: int


class GarbledError(Exception):
    """The other side sent invalid data: nothing more is read from it."""


Buffer = bytes | bytearray | memoryview


class Channel:
    """One end of the socket pair. Every wait ends at a deadline (monotonic; None only in the child).

    Raises TimeoutError at the deadline, EOFError if the other side is gone, GarbledError for invalid data.
    """

    def __init__(self, sock: socket.socket) -> None:
        self._socket = sock

    def say(
        self, kind: Kind, parts: Sequence[Buffer] = (), *, flag: bool = False, number: int = 0, end: float | None = None
    ) -> None:
        """Send a head and its body. parts: C-contiguous buffers"""
        waiting = [memoryview(part).cast("B") for part in parts if len(part)]
        size = sum(len(part) for part in waiting)
        waiting.insert(0, memoryview(HEAD.pack(kind, flag, number, size)))
        try:
            while waiting:
                self._set_limit(end)
                sent = self._socket.sendmsg(waiting[:_PARTS])
                while waiting and sent >= len(waiting[0]):
                    sent -= len(waiting.pop(0))
                if sent:
                    waiting[0] = waiting[0][sent:]
        except (BrokenPipeError, ConnectionResetError) as error:
            raise EOFError from error

    def head(self, end: float | None = None) -> Head:
        """Read the next head."""
        kind, flag, number, size = HEAD.unpack(self.take(HEAD.size, end))
        limit = {Kind.MESSAGES: MAX_BODY, Kind.FRAMES: MAX_BODY, Kind.ENCODE: MAX_BODY, Kind.DECODE: MAX_MESSAGE}
        if size > limit.get(kind, MAX_TEXT) or flag > 1:
            raise GarbledError(f"the body of a message of kind {kind} is too large: {size} bytes")
        return Head(kind, bool(flag), number, size)

    def take(self, size: int, end: float | None = None) -> bytes:
        """Read exactly `size` bytes."""
        data = bytearray(size)
        self.fill(memoryview(data), end)
        return bytes(data)

    def fill(self, view: memoryview, end: float | None = None) -> None:
        """Read bytes until the view is full."""
        at = 0
        while at < len(view):
            self._set_limit(end)
            try:
                got = self._socket.recv_into(view[at:])
            except ConnectionResetError as error:
                raise EOFError from error
            if not got:
                raise EOFError
            at += got

    def drain(self) -> None:
        """Read and discard all further data, until the other side is gone."""
        waste = memoryview(bytearray(1 << 16))
        with contextlib.suppress(EOFError):
            while True:
                self.fill(waste)

    def close(self) -> None:
        """Close this end; the other side notices it."""
        self._socket.close()

    def _set_limit(self, end: float | None) -> None:
        left = None if end is None else end - time.monotonic()
        if left is not None and left <= 0:
            raise TimeoutError
        self._socket.settimeout(left)


# --- messages ---------------------------------------------------------------------------------------------------------


def message_parts(packed: Sequence[bytes]) -> list[Buffer]:
    """The body of an answer with messages."""
    return [part for one in packed for part in (MESSAGE_SIZE.pack(len(one)), one)]


def take_messages(channel: Channel, head: Head, end: float | None) -> list[bytes]:
    """The bytes of each message in an answer."""
    if head.number > MAX_MESSAGES:
        raise GarbledError(f"an answer has {head.number} messages: too many")
    packed, left = [], head.size
    for _ in range(head.number):
        (size,) = MESSAGE_SIZE.unpack(channel.take(MESSAGE_SIZE.size, end))
        left -= MESSAGE_SIZE.size + size
        if left < 0 or size > MAX_MESSAGE:
            raise GarbledError(f"a message has {size} bytes, but its answer has {head.size}")
        packed.append(channel.take(size, end))
    if left:
        raise GarbledError(f"an answer has {left} bytes after its messages")
    return packed


# --- errors -----------------------------------------------------------------------------------------------------------

_ATTRIBUTES: Final = {"offset": int, "needs": int, "field": str, "name": str, "extra": str}
_TREE: Final = {
    name: one for name, one in vars(errors).items() if isinstance(one, type) and issubclass(one, LidarCodecError)
}


def error_bytes(error: BaseException) -> bytes:
    """An error as JSON: name of its type, text, and the attributes of LidarCodecErrors."""
    said: dict[str, Any] = {"type": type(error).__name__, "text": str(error)[:4096]}
    said |= {name: getattr(error, name) for name in _ATTRIBUTES if isinstance(error, LidarCodecError) and
             isinstance(getattr(error, name, None), _ATTRIBUTES[name])}  # fmt: skip
    known = getattr(error, "known", None)
    if isinstance(error, LidarCodecError) and isinstance(known, tuple):
        said["known"] = [str(name) for name in known[:256]]
    return json.dumps(said).encode()


def read_error(data: bytes) -> LidarCodecError | str:
    """The error with its type and attributes, if it is a LidarCodecError; otherwise its text.

    Raises GarbledError.
    """
    try:
        said = read_object(data, MAX_TEXT)
        kind, text = str(said["type"]), str(said["text"])
    except (JsonRefusedError, KeyError):
        raise GarbledError("an error cannot be read") from None
    cls = _TREE.get(kind)
    if cls is None:
        return f"{kind}: {text}" if text else kind
    error: LidarCodecError = cls.__new__(cls)
    Exception.__init__(error, text)
    error.__dict__ |= {"offset": 0} if issubclass(cls, errors.DecodeError) else {}
    error.__dict__ |= {"field": None} if issubclass(cls, errors.SettingsError) else {}
    for name, wanted in _ATTRIBUTES.items():
        if isinstance(said.get(name), wanted) and not isinstance(said[name], bool):
            setattr(error, name, said[name])
    if isinstance(said.get("known"), list):
        error.__dict__["known"] = tuple(map(str, said["known"]))
    if issubclass(cls, errors.MissingReferenceError) and not hasattr(error, "needs"):
        raise GarbledError("a MissingReferenceError has no frame")
    return error

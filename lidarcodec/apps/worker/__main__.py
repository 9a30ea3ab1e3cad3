"""The process of one codec: `python -m lidarcodec.apps.worker SOCKET LIMIT_S`. The module `process` starts it.

It answers requests, and ends when its parent has ended. It ignores signals to the whole process group, because the
parent ends its stream first. While it works, a kernel timer is set, so that it ends even if it hangs in native code
and its parent is gone. (PR_SET_PDEATHSIG is no alternative: it depends on the thread that started the process, and a
stream's threads come and go.)
"""

from __future__ import annotations

import signal

if __name__ == "__main__":  # before slow imports, and only if this module is the main program
    for _signal in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(_signal, signal.SIG_IGN)
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.setitimer(signal.ITIMER_REAL, 60.0)

import contextlib
import os
import resource
import socket
import sys
from typing import Final, TypeVar

from lidarcodec.apps.worker.frames import FrameReader, FrameWriter
from lidarcodec.apps.worker.wire import MAX_TEXT, Channel, GarbledError, Head, Kind, error_bytes, message_parts
from lidarcodec.codecs import table
from lidarcodec.codecs.base import Decoder, Encoder
from lidarcodec.codecs.other_sensors import other_decoder, other_encoder
from lidarcodec.errors import LidarCodecError
from lidarcodec.frame import Frame
from lidarcodec.message import Message
from lidarcodec.settings import StreamSettings, settings_from
from lidarcodec.untrusted.json import read_object
from lidarcodec.wire import pack, unpack

MEMORY_BYTES: Final = 2 * 2**30
"""Limit of the address space. A codec needs 125 to 250 MB; within the limits of a header it is below half a GB."""

T = TypeVar("T")


class Session:
    """Answers requests one after the other, with one encoder or decoder."""

    def __init__(self, channel: Channel) -> None:
        self._channel = channel
        self._reader, self._writer = FrameReader(), FrameWriter()
        self._encoder: Encoder | None = None
        self._decoder: Decoder | None = None

    def answer(self, head: Head) -> None:
        """Read the body of a request, and answer it.

        Raises the errors of the codec, without an answer; EOFError if the parent is gone.
        """
        channel = self._channel
        if head.kind == Kind.ENCODE:
            frame = self._reader.take(channel)
            self._say_messages(_opened(self._encoder).encode(frame, key=head.flag))
        elif head.kind == Kind.DECODE:
            self._say_frames(_opened(self._decoder).decode(unpack(channel.take(head.size))))
        elif head.kind == Kind.FLUSH and self._encoder is not None:
            self._say_messages(self._encoder.flush())
        elif head.kind == Kind.FLUSH:
            self._say_frames(_opened(self._decoder).flush())
        else:
            given = read_object(channel.take(head.size), MAX_TEXT)
            channel.say(Kind.DONE, flag=self._set_up(Kind(head.kind), given))

    def _set_up(self, kind: Kind, given: dict[str, object]) -> bool:
        if kind == Kind.LOAD:
            if given["codec"] is not None:
                table.load(str(given["codec"]))
        elif kind == Kind.OPEN_ENCODER:
            self._decoder = None
            make = other_encoder if given["others"] else table.make_encoder
            self._encoder = make(_settings(given), int(str(given["stream_id"])))
        elif kind == Kind.OPEN_DECODER:
            self._encoder = None
            open_decoder = other_decoder if given["others"] else table.make_decoder
            self._decoder = open_decoder(int(str(given["codec"])))
        else:
            return _opened(self._encoder).apply(_settings(given))
        return False

    def _say_messages(self, messages: list[Message]) -> None:
        packed = [pack(message) for message in messages]
        self._channel.say(Kind.MESSAGES, message_parts(packed), number=len(packed))

    def _say_frames(self, frames: list[Frame]) -> None:
        try:
            parts = [part for frame in frames for part in self._writer.parts(frame)]
        except LidarCodecError:
            self._writer = FrameWriter()  # the sensor that the old one remembers was not sent
            raise
        self._channel.say(Kind.FRAMES, parts, number=len(frames))


def _opened(codec: T | None) -> T:
    if codec is None:
        raise RuntimeError("a request came before a codec was opened")
    return codec


def _settings(given: dict[str, object]) -> StreamSettings:
    values = given["settings"]
    return settings_from(values if isinstance(values, dict) else {})


def _limit_resources() -> None:
    """Limit memory, and disable core files, so that a hostile stream cannot fill a disk with them."""
    for what, most in ((resource.RLIMIT_AS, MEMORY_BYTES), (resource.RLIMIT_CORE, 0)):
        _, hard = resource.getrlimit(what)
        limit = most if hard == resource.RLIM_INFINITY else min(most, hard)
        with contextlib.suppress(OSError, ValueError):  # the system has no such limit
            resource.setrlimit(what, (limit, hard))


def main(number: int, limit_s: float) -> None:
    """Answer requests until the parent is gone."""
    _limit_resources()
    channel = Channel(socket.socket(fileno=number))
    session = Session(channel)
    while True:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        try:
            head = channel.head()
            signal.setitimer(signal.ITIMER_REAL, limit_s)
            try:
                session.answer(head)
            except EOFError:
                raise
            except LidarCodecError as error:
                channel.say(Kind.FAILED, [error_bytes(error)])
            except Exception as error:  # unexpected error: the parent ends this process when it has read the reason
                channel.say(Kind.FAILED, [error_bytes(error)])
                channel.drain()
        except (EOFError, GarbledError):
            return


if __name__ == "__main__":
    main(int(sys.argv[1]), float(sys.argv[2]))
    os._exit(0)  # skip destructors of native libraries, which could hang or crash

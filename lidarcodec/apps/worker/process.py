"""WorkerProcess: one child process that runs a codec, from its start to its end, and the reason of its end.

The child is a new Python process, because a process with threads must not fork. It has its own process group, so that
Ctrl-C in a terminal does not reach it. It gets one socket and only a few environment variables, because an attacker who
controls the codec must not see keys and passwords. After any failure the child is killed and reaped, and the reason is
one line.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final, TypeVar

import lidarcodec
from lidarcodec.apps.worker.frames import FrameReader, FrameWriter
from lidarcodec.apps.worker.wire import Buffer, Channel, GarbledError, Head, Kind, read_error, take_messages
from lidarcodec.errors import DecodeError, LidarCodecError, WorkerError
from lidarcodec.frame import Frame
from lidarcodec.message import Message
from lidarcodec.settings import StreamSettings
from lidarcodec.wire import pack, unpack
from lidarcodec.wire.header import MAX_FRAMES

T = TypeVar("T")

START_S: Final = 20.0
"""Longest wait for a child to become ready. Usually it takes 0.4 s, but much longer on a busy or just booted
machine."""
END_S: Final = 5.0
_PASSED_ON: Final = (
    "LIDARCODEC_WEIGHTS_DIR",
    "PATH",
    "HOME",
    "LANG",
    "LC_",
    "LD_",
    "DYLD_",
    "PYTHON",
    "TMPDIR",
    "TZ",
    "VIRTUAL_ENV",
    "CONDA_",
)
_ENVIRONMENT: Final = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MALLOC_ARENA_MAX": "2"}
"""No codec needs these threads, and each of them would reserve memory."""


def _environment() -> dict[str, str]:
    passed = {name: value for name, value in os.environ.items() if name.startswith(_PASSED_ON)}
    home = str(Path(lidarcodec.__file__).parents[1])
    path = [home, *filter(None, [passed.get("PYTHONPATH")])]
    return passed | _ENVIRONMENT | {"PYTHONPATH": os.pathsep.join(path)}


class WorkerProcess:
    """A child process. It is started at once and ready a little later. One thread sends requests; any thread may end
    it.
    """

    def __init__(self, limit_s: float) -> None:
        """limit_s: longest wait for an answer

        Raises WorkerError if the system cannot start a process.
        """
        self._limit_s = limit_s
        self._asking = threading.Lock()
        self._ready = False
        self._writer, self._reader = FrameWriter(), FrameReader()
        self._begun = time.monotonic()
        ours, theirs = socket.socketpair()
        self._socket, self._channel = ours, Channel(ours)
        command = [sys.executable, "-P", "-m", "lidarcodec.apps.worker", str(theirs.fileno()), str(2 * limit_s)]
        try:
            self._process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                env=_environment(),
                pass_fds=[theirs.fileno()],
                process_group=0,
            )
        except (OSError, ValueError) as error:
            ours.close()
            raise WorkerError(f"cannot start a process for the codec: {error}", "not started") from None
        finally:
            theirs.close()

    @property
    def pid(self) -> int:
        """Its number."""
        return self._process.pid

    @property
    def ended(self) -> bool:
        """Whether the child has ended by itself."""
        return self._process.poll() is not None

    def failure(self) -> WorkerError:
        """The reason why the child has ended by itself."""
        with self._asking:
            return self._failed("it ended", "ended")

    def load(self, codec: str | None) -> None:
        """Make the child import the modules of a codec, if one is given. Does not wait; `ready` waits for the answer.

        Raises WorkerError.
        """
        body = json.dumps({"codec": codec}).encode()
        with self._asking:
            self._guarded(lambda end: self._channel.say(Kind.LOAD, [body], end=end))

    def ready(self, timeout_s: float) -> bool:
        """Whether the child has imported everything. Waits for at most `timeout_s`.

        Raises WorkerError if it ended, failed, or took longer than START_S.
        """
        if self._ready:
            return True
        with self._asking:
            if not self._waiting_answer(timeout_s):
                if time.monotonic() - self._begun > START_S:
                    raise self._failed(f"it was not ready in {START_S:g} s", "not ready")
                return False
            try:
                self._guarded(lambda end: _answer(self._channel, _done, end))
            except WorkerError:
                raise
            except LidarCodecError as error:
                raise self._failed(f"it cannot load its codec: {error}", "not ready") from None
            self._ready = True
            return True

    def open_encoder(self, settings: StreamSettings, stream_id: int, *, others: bool = False) -> None:
        """Make a new encoder, which replaces an open codec. others: of frames of other sensors than the HDL-64E"""
        given = {"settings": settings.model_dump(), "stream_id": str(stream_id), "others": others}
        self._ask(Kind.OPEN_ENCODER, [json.dumps(given).encode()], _done)

    def open_decoder(self, codec: int, *, others: bool = False) -> None:
        """Make a new decoder, which replaces an open codec. others: as of `open_encoder`"""
        self._ask(Kind.OPEN_DECODER, [json.dumps({"codec": codec, "others": others}).encode()], _done)

    def encode(self, frame: Frame, *, key: bool) -> list[Message]:
        """As `Encoder.encode`."""
        return self._ask(Kind.ENCODE, self._writer.parts(frame), _messages, flag=key)

    def apply(self, settings: StreamSettings) -> bool:
        """As `Encoder.apply`."""
        return self._ask(Kind.APPLY, [json.dumps({"settings": settings.model_dump()}).encode()], _done)

    def flush_encoder(self) -> list[Message]:
        """As `Encoder.flush`."""
        return self._ask(Kind.FLUSH, [], _messages)

    def decode(self, message: Message) -> list[Frame]:
        """As `Decoder.decode`."""
        return self._ask(Kind.DECODE, [pack(message)], self._frames)

    def flush_decoder(self) -> list[Frame]:
        """As `Decoder.flush`."""
        return self._ask(Kind.FLUSH, [], self._frames)

    def kill(self) -> None:
        """Kill the child, from any thread. Calls that wait for its answer raise WorkerError."""
        self._process.kill()

    def end(self) -> None:
        """Kill and reap the child. A second call does nothing."""
        self.kill()
        with self._asking:
            self._collect()

    def _ask(
        self, kind: Kind, parts: Sequence[Buffer], take: Callable[[Channel, Head, float], T], *, flag: bool = False
    ) -> T:
        """Send a request and read its answer with `take`.

        Raises WorkerError if there was no answer; otherwise the LidarCodecError that the codec raised, if it did.
        """
        with self._asking:

            def asked(end: float) -> T:
                self._channel.say(kind, parts, flag=flag, end=end)
                return _answer(self._channel, take, end)

            return self._guarded(asked)

    def _frames(self, channel: Channel, head: Head, end: float) -> list[Frame]:
        if head.kind != Kind.FRAMES or head.number > MAX_FRAMES:
            raise GarbledError(f"an answer has the wrong kind {head.kind}, or too many frames ({head.number})")
        return [self._reader.take(channel, end) for _ in range(head.number)]

    def _waiting_answer(self, timeout_s: float) -> bool:
        poll = select.poll()
        try:
            poll.register(self._socket, select.POLLIN)
        except ValueError:  # closed
            return True
        return bool(poll.poll(1e3 * max(0.0, timeout_s)))

    def _guarded(self, ask: Callable[[float], T]) -> T:
        try:
            return ask(time.monotonic() + self._limit_s)
        except TimeoutError:
            raise self._failed(f"it did not answer in {self._limit_s:g} s", "gave no answer") from None
        except GarbledError as error:
            raise self._failed(f"it gave an invalid answer: {error}", "garbled") from None
        except _CodecFaultError as error:
            raise self._failed(f"the codec raised {error}", "raised") from None
        except (EOFError, OSError, ValueError):  # ValueError: we have closed the socket
            raise self._failed("it closed its socket", "closed its socket", wait_s=END_S / 5) from None

    def _failed(self, why: str, cause: str, wait_s: float = 0.0) -> WorkerError:
        """End the child, and return the error. If it ends by itself within `wait_s`, the error has its signal or exit
        code."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(wait_s)
        code = self._process.returncode
        self._process.kill()
        self._collect()
        if code:
            why = cause = _named(code)
        return WorkerError(f"codec process {self.pid}: {why}", cause)

    def _collect(self) -> None:
        self._channel.close()
        with contextlib.suppress(subprocess.TimeoutExpired):  # it waits for a device: the system reaps it later
            self._process.wait(END_S)


class _CodecFaultError(Exception):
    """The codec raised an error that is not a LidarCodecError."""


def _answer(channel: Channel, take: Callable[[Channel, Head, float], T], end: float) -> T:
    head = channel.head(end)
    if head.kind == Kind.FAILED:
        error = read_error(channel.take(head.size, end))
        if isinstance(error, str):
            raise _CodecFaultError(error)
        raise error
    return take(channel, head, end)


def _done(channel: Channel, head: Head, end: float) -> bool:
    if head.kind != Kind.DONE or head.size:
        raise GarbledError(f"an answer has the wrong kind {head.kind}")
    return head.flag


def _messages(channel: Channel, head: Head, end: float) -> list[Message]:
    if head.kind != Kind.MESSAGES:
        raise GarbledError(f"an answer has the wrong kind {head.kind}")
    try:
        return [unpack(packed) for packed in take_messages(channel, head, end)]
    except DecodeError as error:
        raise GarbledError(str(error)) from None


def _named(code: int) -> str:
    if code >= 0:
        return f"ended with exit code {code}"
    try:
        return f"killed by {signal.Signals(-code).name}"
    except ValueError:
        return f"killed by signal {-code}"

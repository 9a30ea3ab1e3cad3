"""Encoders and decoders in a process of their own, and which codecs get one.

Third-party native code can crash on bad input. In a separate process such a crash costs one frame, and the next process
begins with a key frame.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any, Final, Literal, cast, get_args

from lidarcodec.apps.worker.keeper import LIMIT_S, TICK_S, WorkerKeeper
from lidarcodec.apps.worker.process import WorkerProcess
from lidarcodec.codecs import table
from lidarcodec.codecs.base import Decoder, Encoder
from lidarcodec.codecs.other_sensors import check_other, other_decoder, other_encoder, takes_others
from lidarcodec.errors import LidarCodecError, SettingsError, WorkerError
from lidarcodec.frame import Frame
from lidarcodec.message import Message
from lidarcodec.settings import StreamSettings

Isolate = Literal["auto", "always", "never"]
"""Which codecs run in a process of their own: codecs that request it (auto), all, or none."""
VARIABLE: Final = "LIDARCODEC_ISOLATE"
UNUSED_S: Final = 30.0
"""A process without requests is ended after so many seconds."""


def isolate_of(given: str | None) -> Isolate:
    """The given choice, otherwise LIDARCODEC_ISOLATE, otherwise `auto`.

    Raises SettingsError.
    """
    value = given or os.environ.get(VARIABLE) or "auto"
    if value not in get_args(Isolate):
        raise SettingsError(f"isolate must be one of {', '.join(get_args(Isolate))}, not '{value}'", "isolate")
    return cast(Isolate, value)


class IsolatedEncoder:
    """An encoder in the keeper's process. If the process ends, the settings are kept here."""

    def __init__(self, keeper: WorkerKeeper, settings: StreamSettings, stream_id: int, *, others: bool = False) -> None:
        """others: of frames of other sensors than the HDL-64E"""
        self._keeper, self._settings, self._stream_id, self._others = keeper, settings, stream_id, others

    def open(self, process: WorkerProcess) -> None:
        """Start again in this process."""
        process.open_encoder(self._settings, self._stream_id, others=self._others)

    def encode(self, frame: Frame, *, key: bool = False) -> list[Message]:
        """As `Encoder.encode`. Raises WorkerError if the process fails; then the frame is lost."""
        return self._keeper.run(self, lambda process: process.encode(frame, key=key))

    def apply(self, settings: StreamSettings) -> bool:
        """As `Encoder.apply`. If the process fails, the next process begins with these settings."""
        before, self._settings = self._settings, settings
        if not self._keeper.holds(self):
            return True
        if settings == before:
            return False
        try:
            return self._keeper.run(self, lambda process: process.apply(settings))
        except WorkerError:
            return True
        except LidarCodecError:
            self._settings = before
            raise

    def flush(self) -> list[Message]:
        """As `Encoder.flush`. If the process has ended, its frames are lost and the result is empty."""
        if not self._keeper.holds(self):
            return []
        try:
            return self._keeper.run(self, WorkerProcess.flush_encoder)
        except WorkerError:
            return []


class IsolatedDecoder:
    """A decoder in the keeper's process."""

    def __init__(self, keeper: WorkerKeeper, codec: int, *, others: bool = False) -> None:
        """others: of messages of other sensors than the HDL-64E"""
        self._keeper, self._codec, self._others = keeper, codec, others

    def open(self, process: WorkerProcess) -> None:
        """Start again in this process."""
        process.open_decoder(self._codec, others=self._others)

    def decode(self, message: Message) -> list[Frame]:
        """As `Decoder.decode`. Raises WorkerError if the process fails; then the message is lost."""
        return self._keeper.run(self, lambda process: process.decode(message))

    def flush(self) -> list[Frame]:
        """As `Decoder.flush`. If the process has ended, its frames are lost and the result is empty."""
        if not self._keeper.holds(self):
            return []
        try:
            return self._keeper.run(self, WorkerProcess.flush_decoder)
        except WorkerError:
            return []


class Isolation:
    """Makes the codecs of one stream, in this process or in one process of their own. Successive codecs share that
    process."""

    def __init__(
        self, isolate: str | None, on_failure: Callable[[WorkerError], object], limit_s: float = LIMIT_S
    ) -> None:
        """Raises SettingsError for an unknown choice."""
        self._isolate = isolate_of(isolate)
        self._keeper = WorkerKeeper(on_failure, limit_s)
        self._wanted = False

    @property
    def restarts(self) -> int:
        """Number of processes that were started after a failure."""
        return self._keeper.restarts

    @property
    def rests(self) -> bool:
        """Whether there is no process and, because of failures, none will be started for a while."""
        return self._keeper.rests

    @property
    def last_failure(self) -> str | None:
        """Reason of the last failure."""
        return self._keeper.last_failure

    def isolated(self, codec: str) -> bool:
        """Whether this codec runs in a process of its own."""
        return self._isolate == "always" or (self._isolate == "auto" and table.codec(codec).isolated)

    def make_encoder(self, settings: StreamSettings, stream_id: int) -> Encoder:
        """As `table.make_encoder`."""
        if not self.isolated(table.check(settings).codec):
            return table.make_encoder(settings, stream_id)
        table.check_installed(settings.codec)
        self._keeper.codec = settings.codec
        return IsolatedEncoder(self._keeper, settings, stream_id)

    def make_decoder(self, number: int) -> Decoder:
        """As `table.make_decoder`."""
        codec = table.decodable(number)
        self._wanted = self.isolated(codec)
        if not self._wanted:
            return table.make_decoder(number)
        self._keeper.start(codec)
        return IsolatedDecoder(self._keeper, number)

    def make_other_encoder(self, settings: StreamSettings, stream_id: int) -> Encoder:
        """As `other_sensors.other_encoder`."""
        if not self.isolated(check_other(settings).codec):
            return other_encoder(settings, stream_id)
        table.check_installed(settings.codec)
        self._keeper.codec = settings.codec
        return IsolatedEncoder(self._keeper, settings, stream_id, others=True)

    def make_other_decoder(self, number: int) -> Decoder:
        """As `other_sensors.other_decoder`."""
        codec = table.decodable(number)
        self._wanted = takes_others(codec) and self.isolated(codec)
        if not self._wanted:
            return other_decoder(number)
        self._keeper.start(codec)
        return IsolatedDecoder(self._keeper, number, others=True)

    def start(self, codec: str) -> None:
        """Start a process for a codec that needs one. Does not wait."""
        if self.isolated(codec):
            self._keeper.start(codec)

    def ready(self, codec: str, timeout_s: float = TICK_S) -> bool:
        """Whether this codec can code a frame now. Waits for its process for at most `timeout_s`."""
        return not self.isolated(codec) or self._keeper.ready(timeout_s)

    def changed(self, codec: str) -> None:
        """The stream uses this codec now: if it needs no process, end the process."""
        if not self.isolated(codec):
            self._keeper.end_if_unused()

    def tidy(self) -> None:
        """End the process if no decoder needs it any more."""
        if not self._wanted:
            self._keeper.end_if_unused(UNUSED_S)

    def state(self) -> dict[str, Any] | None:
        """For the status, as `WorkerKeeper.state`."""
        return self._keeper.state()

    def close(self) -> None:
        """End everything. A second call does nothing."""
        self._keeper.close()

"""Originals: frames before coding, for programs on the same machine that compare them with decoded frames.

They are sent uncompressed (0.6 MB each) on a key of their own, and only while a program receives them. Otherwise the
option costs nothing. The encoder never waits: frames that cannot be packed in time are skipped.
"""

from __future__ import annotations

import threading

from lidarcodec.apps.mailbox import Mailbox
from lidarcodec.apps.once import Once
from lidarcodec.errors import LidarCodecError, SettingsError
from lidarcodec.frame import Frame
from lidarcodec.pipeline import StreamEncoder
from lidarcodec.settings import StreamSettings
from lidarcodec.transport import Endpoints, Transport
from lidarcodec.transport.base import Priority, Sender
from lidarcodec.transport.keys import StreamKeys
from lidarcodec.wire import pack

WHOLE = StreamSettings(codec="raw")
TICK_S = 0.2
JOIN_S = 5.0


def check_local(endpoints: Endpoints) -> None:
    """Raise SettingsError if originals would leave the machine: they need 50 Mbit/s, and no setting limits that."""
    if not endpoints.on_this_machine:
        raise SettingsError(
            "--original works only on this machine, because frames are uncompressed: leave it out, or connect "
            "to 127.0.0.1",
            "original",
        )


class Originals:
    """Sends offered frames.

    stream_id: of the stream, so that receivers can match both
    """

    def __init__(self, keys: StreamKeys, stream_id: int, once: Once) -> None:
        self._keys, self._once = keys, once
        self._encoder = StreamEncoder(WHOLE, stream_id)
        self._mailbox: Mailbox[Frame] = Mailbox()
        self._sender: Sender | None = None
        self._thread = threading.Thread(target=self._run, name="lidarcodec originals", daemon=True)

    def declare(self, transport: Transport) -> None:
        """Declare the key. Raises TransportError."""
        self._sender = transport.sender(self._keys.original, Priority.BESIDE)
        self._thread.start()

    def offer(self, frame: Frame) -> None:
        """Send a frame before it is encoded; costs nothing while no program receives."""
        if self._sender is not None and self._sender.matching:
            self._mailbox.put(frame)

    def close(self) -> None:
        """End. A second call does nothing."""
        self._mailbox.close()
        if self._thread.is_alive():
            self._thread.join(JOIN_S)
        if self._sender is not None:
            self._sender.close()

    def _run(self) -> None:
        while not self._mailbox.finished:
            frame = self._mailbox.take(TICK_S)
            if frame is None or self._sender is None:
                continue
            try:
                for message in self._encoder.encode(frame, key=True):  # receivers may begin with any frame
                    self._sender.put(pack(message))
            except LidarCodecError as error:
                self._once.add("original errors", error)


__all__ = ["Originals", "check_local"]

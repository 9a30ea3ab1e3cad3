"""Streams: decoded frames of several live streams, the newest of each, in a thread for each of them."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, Final

from lidarcodec.apps.ending import ended
from lidarcodec.apps.once import Once
from lidarcodec.apps.receiver.live_stream import LiveStream
from lidarcodec.cloud import second_returns
from lidarcodec.errors import LidarCodecError, SettingsError, TransportError
from lidarcodec.filling import fills_for
from lidarcodec.frame import Frame
from lidarcodec.transport import Endpoints, Transport
from lidarcodec.transport.keys import StreamKeys

logger = logging.getLogger(__name__)

ABSENT_S: Final = 1.0
"""After this time without a publisher, a stream is said to have none."""

Take = Callable[[StreamKeys, Frame], object]
"""Takes a frame, in the thread of its stream; frames that come meanwhile replace each other."""
TakeMessage = Callable[[StreamKeys, bytes], object]
"""Takes the bytes of a message, every one of them, in the thread that receives them; must be quick."""


class Streams:
    """Receives streams until it is closed or, with `until_end`, all publishers have gone.

    A frame or a message that cannot be handed on is lost, counted and said once; the stream goes on with the next one.

    keys: of the streams;  live: what receives them, by key, while it runs
    """

    def __init__(
        self,
        streams: Sequence[str],
        take: Take,
        *,
        endpoints: Endpoints | None = None,
        transport: Transport | None = None,
        until_end: bool = False,
        take_message: TakeMessage | None = None,
    ) -> None:
        """Raises SettingsError for no stream, for one that is named twice, and for what is no stream."""
        self.keys = [StreamKeys.parse(one) for one in streams]
        if not self.keys:
            raise SettingsError("name at least one stream: VEHICLE/SENSOR", "stream")
        for key in self.keys:
            if self.keys.count(key) > 1:
                raise SettingsError(f"{key.vehicle}/{key.sensor} is named twice", "stream")
        self._take, self._take_message = take, take_message
        self._failure: BaseException | None = None
        self._two_returns: set[StreamKeys] = set()
        self._once = {key: Once(logger) for key in self.keys}
        self.live = {
            key: LiveStream(
                key.prefix,
                endpoints=endpoints,
                transport=transport,
                until_end=until_end,
                on_message=None if take_message is None else partial(self._hand_on_message, key),
            )
            for key in self.keys
        }
        self._threads = [
            threading.Thread(target=self._run, args=(key,), name=f"bridge {key.prefix}", daemon=True)
            for key in self.keys
        ]

    def start(self) -> None:
        """Begin to receive."""
        for thread in self._threads:
            thread.start()

    def wait(self, timeout_s: float) -> bool:
        """Whether all streams have ended, or none was begun; waits for it, at most `timeout_s`.

        Raises what ended one of them, if that was an error.
        """
        for thread in self._threads:
            if thread.ident is not None:
                thread.join(timeout_s / len(self._threads))
        if self._failure is not None:
            raise self._failure
        return not any(thread.is_alive() for thread in self._threads)

    def interrupt(self) -> None:
        """Have all streams end soon; for signal handlers: it takes no lock."""
        for live in self.live.values():
            live.interrupt()

    def fills(self, key: StreamKeys) -> bool:
        """Whether gaps of a stream are filled unless somebody says otherwise: not where its purpose is for programs."""
        settings = (self.live[key].status or {}).get("settings")
        purpose = settings.get("purpose") if isinstance(settings, dict) else None
        return not isinstance(purpose, str) or fills_for(purpose)

    def second_returns(self, key: StreamKeys, frame: Frame) -> int:
        """How many returns of a frame its cloud for viewers lacks, which has first ones. The log says it once."""
        count = second_returns(frame)
        if count and key not in self._two_returns:
            self._two_returns.add(key)
            logger.warning("%s sends two returns of each beam: clouds hold only the first", key.prefix)
        return count

    def summary(self) -> dict[str, dict[str, Any]]:
        """How it goes, by stream."""
        return {f"{key.vehicle}/{key.sensor}": self.summary_of(key) for key in self.keys}

    def summary_of(self, key: StreamKeys) -> dict[str, Any]:
        """How one stream goes; frames that could not be handed on are among its `errors`."""
        summary = self.live[key].summary()
        return {**summary, "errors": {**summary["errors"], **self._once[key].counts}}

    def close(self) -> None:
        """End all streams; harmless when called twice."""
        self.interrupt()
        ended(self._threads)

    def _run(self, key: StreamKeys) -> None:
        live = self.live[key]
        try:
            with live:
                if (first := live.next(ABSENT_S)) is not None:
                    self._hand_on(key, first)
                elif not live.alive and not live.ended:
                    name = f"{key.vehicle}/{key.sensor}"
                    logger.warning("nobody publishes %s yet; waiting. Check the name, and --connect", name)
                for frame in live:
                    self._hand_on(key, frame)
        except LidarCodecError as error:
            self._failure = self._failure or error
            self.interrupt()

    def _hand_on(self, key: StreamKeys, frame: Frame) -> None:
        try:
            self._take(key, frame)
        except TransportError:
            raise
        except Exception as error:  # whatever a vehicle sends, it ends no stream, neither its own nor those of others
            self._once[key].add("frames not handed on", error)

    def _hand_on_message(self, key: StreamKeys, data: bytes) -> None:
        try:
            if self._take_message is not None:
                self._take_message(key, data)
        except Exception as error:  # this thread receives the stream, and has to go on
            self._once[key].add("messages not handed on", error)

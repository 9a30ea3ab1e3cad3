"""Service: what the server does, without HTTP. Its methods block; call them from threads.

The network session is opened in a thread of its own, because a router may be away for long: until then
`transport` raises TransportError, and `open` is False.
"""

from __future__ import annotations

import logging
import threading
from contextlib import ExitStack

from lidarcodec.errors import LidarCodecError, SettingsError, TransportError
from lidarcodec.transport import Transport, open_transport
from lidarcodec.transport.keys import PREFIX, StreamKeys
from lidarcodec_server.config import ServerConfig
from lidarcodec_server.fleet import Fleet, Stream

logger = logging.getLogger(__name__)

START_S = 1.0
"""How long `start` waits for the network: endpoints that cannot be used are known by then."""


class Service:
    """The streams of a fleet.

    closing: things to close before the network session, in reverse order
    """

    def __init__(self, config: ServerConfig, transport: Transport | None = None) -> None:
        """transport: one that is open, and stays the caller's; by default the service opens one of its own."""
        self.config = config
        self.fleet = Fleet(config.max_streams)
        self.closing = ExitStack()
        self._transport: Transport | None = None
        self._given = transport
        self._failure: LidarCodecError | None = None
        self._stop, self._opened = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._open, name="lidarcodec server network", daemon=True)

    @property
    def open(self) -> bool:
        """Whether the network session is there."""
        return self._transport is not None and not self._stop.is_set()

    @property
    def transport(self) -> Transport:
        """The network session.

        Raises TransportError before it is open.
        """
        if self._transport is None or self._stop.is_set():
            raise TransportError("the server has no Zenoh session yet: it is tried again and again")
        return self._transport

    def start(self) -> None:
        """Begin.

        Raises TransportError when the endpoints cannot be used.
        """
        self._thread.start()
        self._opened.wait(START_S)
        if self._failure is not None:
            self.close()
            raise self._failure

    def close(self) -> None:
        """End everything; harmless when called twice."""
        self._stop.set()
        self.closing.close()
        if self._thread.is_alive():
            self._thread.join(10.0)
        if self._transport is not None and self._given is None:
            self._transport.close()

    def stream(self, keys: StreamKeys) -> Stream | None:
        """What is known of a stream; None when it was never seen."""
        return self.fleet.get(keys)

    def streams(self) -> list[Stream]:
        """All streams, by name."""
        return self.fleet.streams()

    # --- the network ------------------------------------------------------------------------------------------------

    def _open(self) -> None:
        try:
            transport = self._given or open_transport(self.config.endpoints, stop=self._stop)
            declared = [
                transport.watch(f"{PREFIX}/*/*/alive", self._publisher_changed),
                transport.listen(f"{PREFIX}/*/*/status", self._status_came),
            ]
            for one in declared:
                self.closing.callback(one.close)
            self._transport = transport
        except LidarCodecError as error:
            if not self._stop.is_set():
                self._failure = error
                logger.warning("no Zenoh session: %s", error)
        finally:
            self._opened.set()

    def _publisher_changed(self, key: str, alive: bool) -> None:
        keys = _keys_of(key)
        if keys is not None and self.fleet.changed(keys, alive=alive):
            logger.info("%s: %s", keys.prefix, "the publisher is there" if alive else "the publisher is gone")

    def _status_came(self, key: str, data: bytes) -> None:
        keys = _keys_of(key)
        if keys is not None:
            self.fleet.told(keys, data)


def _keys_of(key: str) -> StreamKeys | None:
    """The stream of a key; None where vehicle or sensor is no name."""
    try:
        return StreamKeys.parse(key.rpartition("/")[0])
    except SettingsError:
        return None

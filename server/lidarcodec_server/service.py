"""Service: what the server does, without HTTP. Its methods block; call them from threads.

A thread of its own opens the network session, because a router may be away for a long time. Until the session is open,
`transport` raises TransportError, and `open` is False.
"""

from __future__ import annotations

import logging
import threading
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any

from lidarcodec.errors import SettingsError, TransportError, told
from lidarcodec.maps.served.answers import MapAnswers
from lidarcodec.maps.served.shelf import MapShelf
from lidarcodec.transport import Transport, open_transport
from lidarcodec.transport.keys import PREFIX, StreamKeys
from lidarcodec_server.config import ServerConfig
from lidarcodec_server.fleet.control import Control
from lidarcodec_server.fleet.fleet import Fleet, Stream
from lidarcodec_server.limits import Limits, SparseLog
from lidarcodec_server.map_points import TilePoints
from lidarcodec_server.metrics.metrics import Metrics
from lidarcodec_server.migrations import StoreError
from lidarcodec_server.refusals import Refusals
from lidarcodec_server.store.store import Entry, Store
from lidarcodec_server.tokens import TokenBook

if TYPE_CHECKING:
    from lidarcodec_server.operations import Operation

logger = logging.getLogger(__name__)

START_S = 1.0
"""How long `start` waits for the network. Unusable endpoints are known by then."""
RETRY_S = 5.0
"""Interval of later attempts to join the network."""


class Service:
    """The streams of a fleet.

    fleet:   the known streams;  control: changes their settings;  store: data that survives a restart
    tokens:  tokens of clients;  metrics: for Prometheus;  limits: request limits of each client
    refusals: audit entries of requests above the limits
    warnings: a log for warnings that clients can cause
    maps:    the maps that vehicles and the page may ask for;  map_points: their points, for the page
    closing: things to close before the network session, in reverse order
    """

    def __init__(self, config: ServerConfig, transport: Transport | None = None) -> None:
        """transport: an open transport, which the caller closes; by default the service opens its own

        Raises SettingsError if there is no folder of maps where one is configured.
        """
        self.config = config
        self.fleet = Fleet(config.max_streams, config.max_sensors)
        self.store = Store(config.database_url, max_streams=config.max_streams, audit_rows=config.audit_rows)
        self.control = Control(self.fleet, self.store, lambda: self.transport, config.answer_s)
        self.tokens = TokenBook(self.store, opened=config.open)
        self.metrics = Metrics(self.fleet, self.ready)
        self.warnings = SparseLog(logger)
        self.limits = Limits(config.changes_per_second, config.burst)
        self.refusals = Refusals(self.store)
        self.maps = MapShelf([] if config.maps is None else [config.maps])
        self.map_points = TilePoints()
        self.closing = ExitStack()
        self._transport: Transport | None = None
        self._given = transport
        self._failure: Exception | None = None
        self._started = False
        self._stop, self._opened = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._open, name="lidarcodec server network", daemon=True)

    @property
    def open(self) -> bool:
        """Whether the network session is open."""
        return self._transport is not None and not self._stop.is_set()

    def ready(self) -> dict[str, bool]:
        """Whether each part is ready: the Zenoh session with its gate, and the store. It queries the store."""
        gate = self.gate()
        shut = gate is not None and not gate["running"]
        return {"zenoh": self.open and not shut, "store": self.store.ready()}

    def gate(self) -> dict[str, Any] | None:
        """Counts of the gate in front of the TLS port; None without one."""
        return None if self._transport is None else self._transport.gate()

    @property
    def transport(self) -> Transport:
        """The network session.

        Raises TransportError while it is not open.
        """
        if self._transport is None or self._stop.is_set():
            raise TransportError("the server has no Zenoh session yet: it keeps trying to open one")
        return self._transport

    def start(self) -> None:
        """Begin.

        Raises TransportError if the endpoints cannot be used, StoreError if the database cannot be used.
        """
        self.store.open()
        if not self.tokens.needed:
            logger.info("there is no token: anybody who reaches this server can watch and change everything")
        elif not self.tokens.working:
            logger.warning(
                "all tokens were revoked, so nobody has access: create one with `lidarcodec token create NAME`, "
                "or allow access without tokens with --open"
            )
        self.control.start()
        self.maps.start()
        self._thread.start()
        self._opened.wait(START_S)
        self._started = self._failure is None
        if self._failure is not None:
            self.close()
            raise self._failure

    def close(self) -> None:
        """End everything. A second call does nothing."""
        self._stop.set()
        self.control.close()
        self.maps.close()
        self.closing.close()
        if self._thread.is_alive():
            self._thread.join(10.0)
        if self._transport is not None and self._given is None:
            self._transport.close()
        try:
            self.refusals.write()
        except StoreError as error:
            logger.warning("some refused requests could not be written to the audit log: %s", error)
        self.store.close()

    def stream(self, keys: StreamKeys) -> Stream | None:
        """A stream as the server knows it; None if it was never seen and has no stored settings."""
        found = self.fleet.get(keys)
        return Stream(keys) if found is None and self.store.desired(keys) else found

    def streams(self) -> list[Stream]:
        """All streams that were seen or have stored settings, sorted by name."""
        found = self.fleet.streams()
        try:
            kept = self.store.all_desired()
        except StoreError as error:
            self.warnings.warning(
                "the list of streams may be incomplete, because the database cannot be read: %s", error
            )
            kept = []
        seen = {stream.keys for stream in found}
        found += [Stream(keys) for keys in kept if keys not in seen]
        return sorted(found, key=lambda one: (one.keys.vehicle, one.keys.sensor))

    def audit(self, keys: StreamKeys | None, limit: int, before: int | None) -> list[Entry]:
        """Entries of the audit log, newest first, with up-to-date counts."""
        self.refusals.write()
        return self.store.audit(keys, limit, before)

    def enter(self, operation: Operation, result: str) -> None:
        """Write an operation to the audit log. If the log cannot be written, the operation stays valid."""
        who, action, keys = operation.client.name, operation.action, operation.keys
        first, reason = operation.first_frame, operation.reason
        try:
            if operation.too_soon:
                self.refusals.enter(operation)
                return
            self.store.note(keys, who, action, operation.about, result=result, reason=reason, first_frame=first)
        except StoreError as error:
            name = "no stream" if keys is None else keys.prefix
            # Each one, since the rate of changes is limited; only those beyond it could flood the log.
            log = self.warnings if operation.too_soon else logger
            log.warning("an entry could not be written to the audit log: %s of %s by %s: %s", action, name, who, error)

    # --- the network ------------------------------------------------------------------------------------------------

    def _open(self) -> None:
        while not self._stop.is_set():
            with ExitStack() as undone:
                try:
                    self._join_network(undone)
                except BaseException as error:  # a panic of native code is not an Exception
                    failure = told(error)
                    if not self._stop.is_set():
                        logger.warning("cannot join the network: %s", failure)
                    if not self._started:  # then `start` raises it, while what was opened is closed here
                        self._failure = failure
                        self._opened.set()
                        return
                else:
                    undone.pop_all()
                    break
            self._stop.wait(RETRY_S)
        self._opened.set()

    def _join_network(self, undone: ExitStack) -> None:
        """Open the session. undone: gets what must be closed if this fails"""
        transport = self._given
        if transport is None:
            transport = open_transport(self.config.endpoints, stop=self._stop)
            undone.callback(transport.close)
        if self.config.maps is not None:
            self.closing.callback(MapAnswers(self.maps).declare(transport).close)
        for one in (
            transport.watch(f"{PREFIX}/*/*/alive", self._publisher_changed),
            transport.listen(f"{PREFIX}/*/*/status", self._status_came),
        ):
            self.closing.callback(one.close)
        self._transport = transport

    def _publisher_changed(self, key: str, alive: bool) -> None:
        keys = _keys_of(key)
        if keys is not None and self.fleet.changed(keys, alive=alive):
            logger.info("%s: %s", keys.prefix, "the publisher is online" if alive else "the publisher is offline")
            if alive:
                self.control.look_after(keys)

    def _status_came(self, key: str, data: bytes) -> None:
        keys = _keys_of(key)
        if keys is not None:
            again = self.fleet.told(keys, data)
            self.metrics.told(keys)
            if again:
                self.control.look_after(keys)
            else:
                self.control.told(keys)


def _keys_of(key: str) -> StreamKeys | None:
    """The stream of a key; None if its vehicle or sensor is not a valid name."""
    try:
        return StreamKeys.parse(key.rpartition("/")[0])
    except SettingsError:
        return None

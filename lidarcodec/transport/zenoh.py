"""The network: a Zenoh session behind the transport contract. Only this file and zenoh_opening.py import zenoh.

What is done here was measured with Zenoh 1.x: frames come through a ring of one in a thread of the caller's
own, because callbacks queue 256 of them silently; they leave with BLOCK_FIRST, which never blocks and never lets one
slow client behind a router stop the others; receivers refuse what their own session sent; everything that is declared
is given back, within a time limit.
"""

from __future__ import annotations

import json
import logging
import threading
from collections.abc import Callable, Iterator
from itertools import islice
from typing import Any, Self

import zenoh

from lidarcodec.errors import TransportError
from lidarcodec.gate.gate import Gate
from lidarcodec.transport.base import (
    MAX_ANSWERS,
    AliveHandler,
    Closeable,
    EventHandler,
    Guard,
    Inbox,
    KeyHandler,
    MatchHandler,
    Priority,
    QueryHandler,
    Sender,
)
from lidarcodec.transport.certificates import CertificateWatch, certificates_in
from lidarcodec.transport.endpoints import Endpoints
from lidarcodec.transport.gated import put_behind
from lidarcodec.transport.keys import check_key
from lidarcodec.transport.late_threads import CLOSING, let_late_threads_end_at_exit
from lidarcodec.transport.meeting_point import MeetingPoint
from lidarcodec.transport.zenoh_opening import (
    UNREACHABLE,
    config_of,
    open_at_last,
    open_session,
    option_of,
    read_config,
    reason_of,
    telling,
)
from lidarcodec.wire import MAX_MESSAGE

logger = logging.getLogger(__name__)

LOG_FILTER = (
    "warn,zenoh::net::runtime::orchestrator=error,zenoh::net::routing::dispatcher::queries=error,"
    "zenoh::net::protocol::gossip=off,zenoh::net::routing::hat=off,zenoh::bug=off"
)
"""Why a connection was refused is said only at level warn, on the side that refused. The warnings left out repeat what
is raised here, once per attempt, and tell of queries that nobody answered in time, which is expected when a path stands
still. The errors left out came where one of two sessions closed, as it seems of messages that were still on their way.
RUST_LOG overrules it. The library writes to standard output."""
CLOSE_LIMIT_S = 2.0

_QOS: dict[Priority, dict[str, Any]] = {
    Priority.REAL_TIME: {
        "priority": zenoh.Priority.REAL_TIME,
        "congestion_control": zenoh.CongestionControl.BLOCK_FIRST,  # dropped, a report would hold the publisher up
        "express": True,
    },
    Priority.FRAMES: {"priority": zenoh.Priority.DATA, "congestion_control": zenoh.CongestionControl.BLOCK_FIRST},
    Priority.EVERY_FRAME: {"priority": zenoh.Priority.DATA, "congestion_control": zenoh.CongestionControl.BLOCK},
    Priority.STATUS: {"priority": zenoh.Priority.DATA_LOW},
    Priority.BESIDE: {
        "priority": zenoh.Priority.BACKGROUND,
        "congestion_control": zenoh.CongestionControl.BLOCK_FIRST,
    },
}


def _within_limit(close: Callable[[], object], what: str) -> None:
    """Give something back in at most CLOSE_LIMIT_S; an exit must never hang on a network."""

    def run() -> None:
        try:
            close()
        except (zenoh.ZError, RuntimeError) as error:  # borrowed by a put: the session ends it
            logger.debug("closing %s: %s", what, reason_of(error))

    thread = threading.Thread(target=run, name=f"{CLOSING} {what}", daemon=True)
    try:
        thread.start()
    except RuntimeError as error:  # no more threads: the end of the process gives it back
        logger.warning("closing %s: %s", what, error)
        return
    thread.join(CLOSE_LIMIT_S)
    if thread.is_alive():
        logger.warning("%s did not close within %g s and was abandoned", what, CLOSE_LIMIT_S)


class _Declared:
    """Something declared on a session; given back once."""

    def __init__(self, what: str, entities: list[Any], forget: Callable[[_Declared], None]) -> None:
        self._what, self._entities, self._forget = what, entities, forget

    def close(self) -> None:
        """Undeclare; harmless when called twice."""
        entities, self._entities = self._entities, []
        for entity in entities:
            _within_limit(entity.undeclare, self._what)
        self._forget(self)


class _Sender(_Declared):
    """Puts on one key."""

    def __init__(self, key: str, entities: list[Any], forget: Callable[[_Declared], None]) -> None:
        super().__init__(key, entities, forget)
        self._key, self._publisher = key, entities[0]

    @property
    def matching(self) -> bool:
        """Whether any other session receives this key."""
        try:
            return bool(self._publisher.matching_status.matching)
        except zenoh.ZError:
            return False

    def put(self, data: bytes, attachment: bytes | None = None) -> None:
        """Hand over the bytes; at most a few milliseconds. Raises TransportError when closed."""
        with telling(f"cannot send on {self._key}"):
            self._publisher.put(data, attachment=attachment)


class _Inbox(_Declared):
    """A ring of the newest messages."""

    def __init__(self, key: str, entities: list[Any], forget: Callable[[_Declared], None]) -> None:
        super().__init__(key, entities, forget)
        self._key, self._ring, self._warned = key, entities[0].handler, False

    def receive(self) -> bytes | None:
        """The oldest message of the ring, as soon as there is one; None once closed."""
        while True:
            try:
                data = self._fitting(self._ring.recv())
            except zenoh.ZError:
                return None
            if data is not None:
                return data

    def receive_now(self) -> bytes | None:
        """The same without waiting; None if there is none."""
        try:
            while (sample := self._ring.try_recv()) is not None:
                if (data := self._fitting(sample)) is not None:
                    return data
        except zenoh.ZError:
            pass
        return None

    def _fitting(self, sample: zenoh.Sample) -> bytes | None:
        """The bytes of a message; None if it is too long."""
        payload = sample.payload
        if len(payload) <= MAX_MESSAGE:
            return bytes(payload.to_bytes())
        if not self._warned:
            self._warned = True
            logger.warning("dropped %d bytes on %s: a message has at most %d", len(payload), self._key, MAX_MESSAGE)
        return None


class ZenohTransport:
    """One Zenoh session. Thread-safe."""

    def __init__(
        self, session: zenoh.Session, meeting_point: MeetingPoint | None, watch: CertificateWatch, gate: Gate | None
    ) -> None:
        self._session, self._meeting_point, self._watch, self._gate = session, meeting_point, watch, gate
        self._guard = Guard()
        self._lock = threading.Lock()
        self._declared: list[_Declared] = []

    @classmethod
    def open(cls, endpoints: Endpoints, *, stop: threading.Event | None = None) -> Self:
        """Open a session; one that must reach a router first tries until it does, or `stop` is set.

        Raises TransportError for a configuration or an endpoint that cannot be used, and when stopped.
        """
        zenoh.init_log_from_env_or(LOG_FILTER)
        let_late_threads_end_at_exit()
        base = None if endpoints.config is None else read_config(endpoints.config)
        config = config_of(endpoints.options(), base)
        client = json.loads(config.get_json("mode")) == "client"
        point = MeetingPoint(
            endpoints.loopback_port, lambda: open_session(config_of(endpoints.rendezvous_options())).close
        )
        watch = CertificateWatch(certificates_in(option_of(config)), str(endpoints.config))
        gate = None
        try:
            gate, behind = put_behind(option_of(config))
            config_of(behind, config)
            with telling("cannot open a Zenoh session"):
                if endpoints.local:
                    point.start()
                watch.start()  # first: with a certificate that has ended, no session may ever be opened
            session = open_at_last(config, stop, None if not client else "" if base is None else UNREACHABLE)
        except TransportError:
            point.close()
            watch.close()
            if gate is not None:
                gate.close()
            raise
        logger.info("session %s open as %s", session.zid(), endpoints.effective_mode)
        transport = cls(session, point if endpoints.local else None, watch, gate)
        if endpoints.local:
            point.watch(lambda: transport.connected)
        return transport

    @property
    def identity(self) -> str:
        """Zenoh's own id of this session."""
        return str(self._session.zid())

    @property
    def connected(self) -> int:
        """Number of other sessions this one is linked to, the meeting point's own included."""
        try:
            return len(self._session.info.peers_zid()) + len(self._session.info.routers_zid())
        except zenoh.ZError:
            return 0

    def sender(self, key: str, priority: Priority, on_match: MatchHandler | None = None) -> Sender:
        """A sender on one key, with the quality of service of its priority."""
        publisher = self._declare(key, "declare_publisher", allowed_destination=zenoh.Locality.REMOTE, **_QOS[priority])
        entities: list[Any] = [publisher]
        if on_match is not None:
            told = on_match

            def changed(status: zenoh.MatchingStatus) -> None:
                self._guard.call(f"matching on {key}", told, bool(status.matching))

            with telling(f"cannot watch who receives {key}"):
                entities.insert(1, publisher.declare_matching_listener(changed))
        sender = _Sender(key, entities, self._forget)
        self._remember(sender)
        return sender

    def inbox(self, key: str, depth: int = 1) -> Inbox:
        """A ring on one key; its receiver is the caller's thread."""
        ring: Any = zenoh.handlers.RingChannel(depth)
        subscriber = self._declare(key, "declare_subscriber", ring, allowed_origin=zenoh.Locality.REMOTE)
        inbox = _Inbox(key, [subscriber], self._forget)
        self._remember(inbox)
        return inbox

    def listen(self, key: str, handler: EventHandler) -> Closeable:
        """Hand small events to the handler, in a thread of their own."""

        def came(sample: zenoh.Sample) -> None:
            name = str(sample.key_expr)
            if sample.kind == zenoh.SampleKind.PUT and self._guard.fits(key, len(sample.payload)):
                self._guard.call(key, handler, name, sample.payload.to_bytes())

        return self._keep(
            key, self._declare(key, "declare_subscriber", came, wild=True, allowed_origin=zenoh.Locality.REMOTE)
        )

    def answer(self, key: str, handler: QueryHandler) -> Closeable:
        """Answer queries on one key; a query that is not answered is always dropped, so that nobody waits for it."""
        check_key(key)
        return self.answer_under(key, lambda _, data: handler(data))

    def answer_under(self, expression: str, handler: KeyHandler) -> Closeable:
        """Answer queries on all keys that an expression covers."""

        def asked(query: zenoh.Query) -> None:
            with query:
                key = str(query.key_expr)
                size = 0 if query.payload is None else len(query.payload)
                if "*" in key or not self._guard.fits(expression, size):
                    return
                data = b"" if query.payload is None else query.payload.to_bytes()
                answer = self._guard.call(expression, handler, key, data)
                if isinstance(answer, bytes):
                    self._guard.call(f"answers on {expression}", query.reply, key, answer)

        declared = self._declare(
            expression, "declare_queryable", asked, wild=True, allowed_origin=zenoh.Locality.REMOTE
        )
        return self._keep(expression, declared)

    def ask(self, key: str, data: bytes = b"", timeout_s: float = 1.0, *, beside: bool = False) -> bytes | None:
        """The first answer; None when there is none in time. An answer has the priority of its question."""
        priority = zenoh.Priority.BACKGROUND if beside else zenoh.Priority.INTERACTIVE_HIGH
        return next(self._answers(key, data, timeout_s, priority=priority), None)

    def ask_all(self, key: str, data: bytes = b"", timeout_s: float = 1.0) -> list[bytes]:
        """All answers that come in time. Zenoh would merge those on one key."""
        each = {"priority": zenoh.Priority.BACKGROUND, "consolidation": zenoh.ConsolidationMode.NONE}
        return list(islice(self._answers(key, data, timeout_s, **each), MAX_ANSWERS))

    def _answers(self, key: str, data: bytes, timeout_s: float, **options: Any) -> Iterator[bytes]:
        check_key(key)
        with telling(f"cannot ask {key}"):
            replies = self._session.get(
                key, payload=data, timeout=timeout_s, allowed_destination=zenoh.Locality.REMOTE, **options
            )
            for reply in replies:
                sample = reply.ok
                if sample is not None and self._guard.fits(key, len(sample.payload)):
                    yield bytes(sample.payload.to_bytes())

    def token(self, key: str) -> Closeable:
        """A liveliness token: others see it go within milliseconds of a kill, and 10 s after a link went dead."""
        check_key(key)
        with telling(f"cannot declare {key}"):
            return self._keep(key, self._session.liveliness().declare_token(key))

    def watch(self, key: str, handler: AliveHandler) -> Closeable:
        """Hand tokens, its own included, to the handler."""
        check_key(key, wild=True)

        def changed(sample: zenoh.Sample) -> None:
            self._guard.call(key, handler, str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT)

        with telling(f"cannot watch {key}"):
            return self._keep(key, self._session.liveliness().declare_subscriber(key, changed, history=True))

    def close(self) -> None:
        """Give back everything, in at most a few seconds; harmless when called twice."""
        with self._lock:
            declared, self._declared = self._declared, []
        for one in reversed(declared):
            one.close()
        if not self._session.is_closed():
            _within_limit(self._session.close, "the session")
        if self._meeting_point is not None:
            self._meeting_point.close()
        self._watch.close()
        if self._gate is not None:
            self._gate.close()

    def gate(self) -> dict[str, Any] | None:
        """Counts of the gate in front of TLS; None without one."""
        return None if self._gate is None else self._gate.state()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def _declare(self, key: str, method: str, *handler: Any, wild: bool = False, **options: Any) -> Any:
        check_key(key, wild=wild)
        with telling(f"cannot declare {key}"):
            return getattr(self._session, method)(key, *handler, **options)

    def _keep(self, key: str, entity: Any) -> Closeable:
        one = _Declared(key, [entity], self._forget)
        self._remember(one)
        return one

    def _remember(self, one: _Declared) -> None:
        with self._lock:
            self._declared.append(one)

    def _forget(self, one: _Declared) -> None:
        with self._lock:
            if one in self._declared:
                self._declared.remove(one)

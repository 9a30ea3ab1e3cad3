"""A transport inside one process, for tests and for programs whose two ends are in the same process.

>>> network = MemoryNetwork()
>>> with network.transport() as car, network.transport() as office:
...     inbox = office.inbox("a/b")
...     car.sender("a/b", Priority.FRAMES).put(b"old"); car.sender("a/b", Priority.FRAMES).put(b"new")
...     inbox.receive()
b'new'
"""

from __future__ import annotations

import secrets
import threading
from collections import deque
from collections.abc import Callable
from typing import Any, Self, TypeVar

from lidarcodec.errors import TransportError
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
from lidarcodec.transport.keys import check_key, matches

WAITING_EVENTS = 256
"""Most small events that wait for one handler; with more, the oldest are dropped."""


class _Worker:
    """Runs the calls of one handler in order, in a thread of its own."""

    def __init__(self, name: str) -> None:
        self._calls: deque[Callable[[], object]] = deque(maxlen=WAITING_EVENTS)
        self._condition = threading.Condition()
        self._closed = False
        self._thread = threading.Thread(target=self._run, name=f"memory {name}", daemon=True)
        self._thread.start()

    def post(self, call: Callable[[], object]) -> None:
        """Schedule a call."""
        with self._condition:
            self._calls.append(call)
            self._condition.notify()

    def close(self) -> None:
        """Stop, and wait for a running call, unless this is that call."""
        with self._condition:
            self._closed = True
            self._condition.notify()
        if threading.current_thread() is not self._thread:
            self._thread.join(2.0)

    def _run(self) -> None:
        while True:
            with self._condition:
                self._condition.wait_for(lambda: bool(self._calls) or self._closed)
                if self._closed:
                    return
                call = self._calls.popleft()
            call()


class _Entity:
    """Something that a transport declared on a key."""

    def __init__(self, owner: MemoryTransport, key: str) -> None:
        self.owner, self.key = owner, key
        self.worker: _Worker | None = None

    def close(self) -> None:
        """Undeclare it. A second call does nothing."""
        self.owner.network.remove(self)
        if self.worker is not None:
            self.worker.close()


class _Listener(_Entity):
    handler: EventHandler


class _Queryable(_Entity):
    handler: KeyHandler


class _Token(_Entity):
    pass


class _Watcher(_Entity):
    handler: AliveHandler


class _Inbox(_Entity):
    """A slot of the newest messages."""

    def __init__(self, owner: MemoryTransport, key: str, depth: int) -> None:
        super().__init__(owner, key)
        self._condition = threading.Condition()
        self._newest: deque[bytes] = deque(maxlen=depth)
        self._closed = False

    def drop_in(self, data: bytes) -> None:
        """Take a message, in place of the oldest if the slot is full."""
        with self._condition:
            self._newest.append(data)
            self._condition.notify()

    def receive(self) -> bytes | None:
        """Wait for a message; None once closed."""
        with self._condition:
            self._condition.wait_for(lambda: bool(self._newest) or self._closed)
            return None if self._closed else self._newest.popleft()

    def receive_now(self) -> bytes | None:
        """A message, if one waits."""
        with self._condition:
            return self._newest.popleft() if self._newest and not self._closed else None

    def close(self) -> None:
        """Close it; a waiting `receive` ends."""
        with self._condition:
            self._closed = True
            self._condition.notify_all()
        super().close()


class _Sender(_Entity):
    """Puts on one key."""

    on_match: MatchHandler | None = None
    told = False

    @property
    def matching(self) -> bool:
        """Whether any other transport receives this key."""
        return bool(self.owner.network.receivers(self))

    def put(self, data: bytes, attachment: bytes | None = None) -> None:
        """Pass on the bytes; the attachment is ignored. Raises TransportError if closed."""
        network = self.owner.network
        if not network.has(self):
            raise TransportError(f"cannot send on {self.key}: closed")
        data = bytes(data)
        for receiver in network.receivers(self):
            if isinstance(receiver, _Inbox):
                receiver.drop_in(data)
            elif isinstance(receiver, _Listener):
                receiver.owner.deliver(receiver, self.key, data)


_T = TypeVar("_T", bound=_Entity)


class MemoryNetwork:
    """The network of the transports in one process."""

    def __init__(self) -> None:
        self._lock = threading.RLock()
        self._entities: list[_Entity] = []

    def transport(self) -> MemoryTransport:
        """A new transport on this network."""
        return MemoryTransport(self)

    def add(self, entity: _Entity) -> None:
        """Declare, and notify all listeners."""
        with self._lock:
            self._entities.append(entity)
            if isinstance(entity, _Watcher):
                for token in [one for one in self._entities if isinstance(one, _Token)]:
                    if matches(entity.key, token.key):
                        entity.owner.tell(entity, token.key, alive=True)
        self._changed(entity, alive=True)

    def remove(self, entity: _Entity) -> None:
        """Undeclare, and notify all listeners."""
        with self._lock:
            if entity not in self._entities:
                return
            self._entities.remove(entity)
        self._changed(entity, alive=False)

    def has(self, entity: _Entity) -> bool:
        """Whether an entity is still declared."""
        with self._lock:
            return entity in self._entities

    def receivers(self, sender: _Sender) -> list[_Inbox | _Listener]:
        """Inboxes and listeners of other transports on the sender's key."""
        with self._lock:
            found: list[_Inbox | _Listener] = [*self._of(_Inbox, sender.owner), *self._of(_Listener, sender.owner)]
            return [one for one in found if matches(one.key, sender.key)]

    def queryables(self, owner: MemoryTransport, key: str) -> list[_Queryable]:
        """Queryables of other transports on a key."""
        with self._lock:
            return [one for one in self._of(_Queryable, owner) if matches(one.key, key)]

    def all_of(self, owner: MemoryTransport) -> list[_Entity]:
        """Everything a transport has declared."""
        with self._lock:
            return [one for one in self._entities if one.owner is owner]

    def _of(self, kind: type[_T], other_than: MemoryTransport) -> list[_T]:
        return [one for one in self._entities if isinstance(one, kind) and one.owner is not other_than]

    def _changed(self, entity: _Entity, *, alive: bool) -> None:
        with self._lock:
            if isinstance(entity, _Token):
                for watcher in [one for one in self._entities if isinstance(one, _Watcher)]:
                    if matches(watcher.key, entity.key):
                        watcher.owner.tell(watcher, entity.key, alive=alive)
            if isinstance(entity, _Sender | _Inbox | _Listener):
                for sender in [one for one in self._entities if isinstance(one, _Sender)]:
                    sender.owner.tell_match(sender)


class MemoryTransport:
    """One end on a MemoryNetwork; passes the same contract as the Zenoh transport."""

    def __init__(self, network: MemoryNetwork) -> None:
        self.network = network
        self.identity = secrets.token_hex(16)
        self._guard = Guard()
        self._closed = False

    def sender(self, key: str, priority: Priority, on_match: MatchHandler | None = None) -> Sender:
        """A sender on one key. The priority has no effect, because there is no slow link."""
        sender = _Sender(self, self._checked(key))
        if on_match is not None:
            sender.on_match, sender.worker = on_match, _Worker(f"matching {key} {priority.value}")
        self.network.add(sender)
        return sender

    def inbox(self, key: str, depth: int = 1) -> Inbox:
        """A slot of the newest messages."""
        inbox = _Inbox(self, self._checked(key), depth)
        self.network.add(inbox)
        return inbox

    def listen(self, key: str, handler: EventHandler) -> Closeable:
        """Pass small events to the handler, in a thread of its own."""
        listener = _Listener(self, self._checked(key, wild=True))
        listener.handler, listener.worker = handler, _Worker(key)
        self.network.add(listener)
        return listener

    def answer(self, key: str, handler: QueryHandler) -> Closeable:
        """Answer queries on one key."""
        return self._answer(self._checked(key), lambda _, data: handler(data))

    def answer_under(self, expression: str, handler: KeyHandler) -> Closeable:
        """Answer queries on all keys that an expression covers."""
        return self._answer(self._checked(expression, wild=True), handler)

    def ask(self, key: str, data: bytes = b"", timeout_s: float = 1.0, *, beside: bool = False) -> bytes | None:
        """The first answer; None if none comes in time. There is no slow link, so `beside` has no effect."""
        answers = self._answers(key, data, timeout_s, 1)
        return answers[0] if answers else None

    def ask_all(self, key: str, data: bytes = b"", timeout_s: float = 1.0) -> list[bytes]:
        """All answers that come in time."""
        return self._answers(key, data, timeout_s, MAX_ANSWERS)

    def token(self, key: str) -> Closeable:
        """A token that others see until it is closed."""
        token = _Token(self, self._checked(key))
        self.network.add(token)
        return token

    def watch(self, key: str, handler: AliveHandler) -> Closeable:
        """Pass tokens, including its own, to the handler."""
        watcher = _Watcher(self, self._checked(key, wild=True))
        watcher.handler, watcher.worker = handler, _Worker(key)
        self.network.add(watcher)
        return watcher

    def gate(self) -> dict[str, Any] | None:
        """None: there is no port."""
        return None

    def close(self) -> None:
        """Undeclare everything. A second call does nothing."""
        self._closed = True
        for one in reversed(self.network.all_of(self)):
            one.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def deliver(self, listener: _Listener, key: str, data: bytes) -> None:
        """Call a listener with an event."""
        if listener.worker is not None and self._guard.fits(listener.key, len(data)):
            listener.worker.post(lambda: self._guard.call(listener.key, listener.handler, key, data))

    def tell(self, watcher: _Watcher, key: str, *, alive: bool) -> None:
        """Call a watcher with a token's change."""
        if watcher.worker is not None:
            watcher.worker.post(lambda: self._guard.call(watcher.key, watcher.handler, key, alive))

    def tell_match(self, sender: _Sender) -> None:
        """Call a sender's match handler if matching changed."""
        handler, worker = sender.on_match, sender.worker
        if handler is None or worker is None:
            return
        now = sender.matching
        if now != sender.told:
            sender.told = now
            worker.post(lambda: self._guard.call(f"matching on {sender.key}", handler, now))

    def _answer(self, key: str, handler: KeyHandler) -> Closeable:
        queryable = _Queryable(self, key)
        queryable.handler, queryable.worker = handler, _Worker(key)
        self.network.add(queryable)
        return queryable

    def _answers(self, key: str, data: bytes, timeout_s: float, most: int) -> list[bytes]:
        """The first `most` answers."""
        self._checked(key)
        answers: list[bytes] = []
        done = threading.Condition()
        asked = self.network.queryables(self, key)
        left = len(asked)

        def run(queryable: _Queryable) -> None:
            nonlocal left
            given = None
            if self._guard.fits(key, len(data)):
                given = queryable.owner._guard.call(key, queryable.handler, key, bytes(data))
            with done:
                left -= 1
                if isinstance(given, bytes) and self._guard.fits(key, len(given)):
                    answers.append(given)
                done.notify()

        for queryable in asked:
            if queryable.worker is not None:
                queryable.worker.post(lambda queryable=queryable: run(queryable))  # type: ignore[misc]
        with done:
            done.wait_for(lambda: len(answers) >= most or left == 0, timeout_s)
            return answers[:most]

    def _checked(self, key: str, *, wild: bool = False) -> str:
        if self._closed:
            raise TransportError("the transport is closed")
        return check_key(key, wild=wild)

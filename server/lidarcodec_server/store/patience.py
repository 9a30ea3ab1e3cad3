"""Time limits for a database on the network, which may become unreachable without an error.

The database's own limits (`statement_timeout`) work only while it works. So the server closes a connection that is in
use for too long. After that only one thread at a time asks the database, and all others are refused at once. Otherwise
all threads would wait, and requests that need no database would wait for a thread.
"""

from __future__ import annotations

import contextlib
import os
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Final

import sqlalchemy as sa
from sqlalchemy.engine import Engine
from sqlalchemy.exc import DBAPIError, DisconnectionError, SQLAlchemyError

STUCK_S: Final = 6.0
"""Longest use of a connection: somewhat longer than the database's own limit of a statement."""
LONG_S: Final = 1.0
"""A failure within this time does not count as a delay."""
REST_S: Final = 5.0
"""Wait before a database that did not answer is asked again."""
_SHUT, _TIMER = "shut", "timer"


def close_stuck_connections(engine: Engine) -> None:
    """Close connections that are in use for longer than STUCK_S, and test each connection before its use."""

    def connects(connection: Any, record: Any) -> None:
        # A duplicate of the handle: the driver's own may belong to another connection when this one is closed.
        record.info[_SHUT] = socket.socket(fileno=os.dup(connection.fileno()))

    def goes_out(connection: Any, record: Any, _: object) -> None:
        timer = record.info[_TIMER] = threading.Timer(STUCK_S, _shut, (record.info[_SHUT],))
        timer.daemon = True
        timer.start()
        try:
            engine.dialect.do_ping(connection)
        except Exception as error:
            _stop(record)
            raise DisconnectionError(str(error)) from None

    def comes_back(_: object, record: Any) -> None:
        _stop(record)

    def closes(_: object, record: Any) -> None:
        _stop(record)
        handle = record.info.pop(_SHUT, None)
        if handle is not None:
            handle.close()

    listeners: dict[str, Callable[..., None]] = {
        "connect": connects,
        "checkout": goes_out,
        "checkin": comes_back,
        "close": closes,
    }
    for name, listener in listeners.items():
        sa.event.listen(engine, name, listener)


def _stop(record: Any) -> None:
    timer = record.info.pop(_TIMER, None)
    if timer is not None:
        timer.cancel()


def _shut(handle: socket.socket) -> None:
    with contextlib.suppress(OSError):
        handle.shutdown(socket.SHUT_RDWR)


class Patience:
    """Decides whether to ask the database. Thread-safe.

    >>> clock = [0.0]
    >>> patience = Patience(lambda: clock[0])
    >>> with contextlib.suppress(SQLAlchemyError), patience.asking(OSError):
    ...     clock[0] = 6.0
    ...     raise sa.exc.TimeoutError
    >>> try:
    ...     with patience.asking(OSError): pass
    ... except OSError as error: print(error)
    it did not answer; it is asked again soon
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._lock = threading.Lock()
        self._rest_until_s: float | None = None

    @contextmanager
    def asking(self, refusal: type[Exception]) -> Iterator[None]:
        """Ask the database. After a failure there is a pause; after each pause one thread asks again.

        Raises `refusal` during the pause.
        """
        with self._lock:
            began_s = self._clock()
            if self._rest_until_s is not None:
                if began_s < self._rest_until_s:
                    raise refusal("it did not answer; it is asked again soon")
                self._rest_until_s = began_s + REST_S + STUCK_S
        try:
            yield
        except Exception as error:
            with self._lock:
                now_s = self._clock()
                late = now_s - began_s >= LONG_S or self._rest_until_s is not None
                self._rest_until_s = now_s + REST_S if late and not _answered(error) else None
            raise
        with self._lock:
            self._rest_until_s = None


def _answered(error: Exception) -> bool:
    """Whether the database itself answered with this error, or the error is not about the database."""
    if isinstance(error, DBAPIError):
        return getattr(error.orig, "sqlstate", None) is not None
    return not isinstance(error, SQLAlchemyError)

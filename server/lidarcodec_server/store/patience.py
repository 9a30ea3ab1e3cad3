"""How long the server waits for a database on the network, which may be cut off, or stand still, without a word.

What the database is told of limits (`statement_timeout`) holds only while it works. So a connection that is in use for
too long is shut from here, and after that nobody but one asks for a while: the others are refused at once. Otherwise
all threads of the server would wait, and requests that need no database with them.
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
"""A connection may be in use so long: somewhat longer than the database itself lets a statement take."""
LONG_S: Final = 1.0
"""Failures sooner than this delay no client."""
REST_S: Final = 5.0
"""Until a database that did not answer is asked again."""
_SHUT, _TIMER = "shut", "timer"


def never_for_ever(engine: Engine, limit_s: float = STUCK_S) -> None:
    """Shut connections that are in use for longer than `limit_s`, and try each one before it is used."""

    def connects(connection: Any, record: Any) -> None:
        # A handle of our own: that of the driver may be another connection's by the time it is shut.
        record.info[_SHUT] = socket.socket(fileno=os.dup(connection.fileno()))

    def goes_out(connection: Any, record: Any, _: object) -> None:
        timer = record.info[_TIMER] = threading.Timer(limit_s, _shut, (record.info[_SHUT],))
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
    """Whether a database is asked at all. Thread-safe.

    >>> clock = [0.0]
    >>> patience = Patience(lambda: clock[0])
    >>> with contextlib.suppress(SQLAlchemyError), patience.asking(OSError):
    ...     clock[0] = 6.0
    ...     raise sa.exc.TimeoutError
    >>> try:
    ...     with patience.asking(OSError): pass
    ... except OSError as error: print(error)
    it did not answer and will be asked again soon
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._lock = threading.Lock()
        self._rest_until_s: float | None = None

    @contextmanager
    def asking(self, refusal: type[Exception]) -> Iterator[None]:
        """Ask the database. While it rests, one asks each time that the rest is over.

        Raises `refusal` for the others.
        """
        with self._lock:
            began_s = self._clock()
            if self._rest_until_s is not None:
                if began_s < self._rest_until_s:
                    raise refusal("it did not answer and will be asked again soon")
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
    """Whether an error is the database's own, or none of the database at all."""
    if isinstance(error, DBAPIError):
        return getattr(error.orig, "sqlstate", None) is not None
    return not isinstance(error, SQLAlchemyError)

"""SQLAlchemy engines for the store: every wait has a time limit."""

from __future__ import annotations

from typing import Any, Final

import sqlalchemy as sa
from sqlalchemy.engine import Connection, Engine

from lidarcodec_server.store.patience import close_stuck_connections

BUSY_S: Final = 5.0
"""How long to wait for a lock, a connection or a statement."""


def engine_of(url: sa.URL) -> Engine:
    """Make an engine; each of its waits has a time limit."""
    if url.get_backend_name() == "sqlite":
        engine = sa.create_engine(url, connect_args={"timeout": BUSY_S})
        sa.event.listen(engine, "connect", _sqlite_connects)
        sa.event.listen(engine, "begin", _sqlite_begins)
        return engine
    limits: dict[str, Any] = {}
    if url.get_backend_name() == "postgresql":
        milliseconds = int(1e3 * BUSY_S)
        limits = {"connect_timeout": int(BUSY_S), "client_encoding": "UTF8"}  # of SQL_ASCII, names would come as bytes
        own = f"-c statement_timeout={milliseconds} -c lock_timeout={milliseconds}"
        limits["options"] = " ".join([*url.normalized_query.get("options", ()), own])  # what the URL says holds, too
    engine = sa.create_engine(url, pool_pre_ping=not limits, pool_timeout=BUSY_S, pool_size=4, connect_args=limits)
    if limits:
        close_stuck_connections(engine)
    return engine


def _sqlite_connects(connection: Any, _record: object) -> None:
    connection.isolation_level = None  # we begin transactions ourselves: the driver's would not include schema changes
    for pragma in ("journal_mode=WAL", f"busy_timeout={int(1e3 * BUSY_S)}", "synchronous=FULL"):
        connection.execute(f"PRAGMA {pragma}").close()


def _sqlite_begins(connection: Connection) -> None:
    writes = connection.get_execution_options().get("writes")
    connection.exec_driver_sql("BEGIN IMMEDIATE" if writes else "BEGIN")

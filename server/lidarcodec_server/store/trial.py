"""try_a_change: tests whether a database accepts changes, without changing it.

This is needed because a database that is full, read-only, locked or without tables still answers queries and begins
transactions.
"""

from __future__ import annotations

import os
import time
from typing import Any, Final, cast

import sqlalchemy as sa
from sqlalchemy.engine import Connection

from lidarcodec_server.store.tables import audit, desired, facts, tokens

ENTRY_BYTES: Final = 16_384
"""More data than fits into the free space of a table's pages. It is random, so it cannot be compressed."""


def try_a_change(connection: Connection) -> None:
    """Write an entry to the audit log, delete it, and lock the other tables as a change does.

    Raises errors of the database; the end of the transaction may raise them, too.
    """
    for table in (desired, tokens, facts):
        connection.execute(sa.delete(table).where(sa.false()))
    values = {"vehicle": "", "sensor": "", "at_ns": time.time_ns(), "who": "", "action": "try", "result": "try"}
    filling = os.urandom(ENTRY_BYTES // 2).hex()
    made = connection.execute(sa.insert(audit).values(**values, changes={}, reason=filling))
    connection.execute(sa.delete(audit).where(audit.c.id == cast(Any, made.inserted_primary_key)[0]))

"""try_a_change: whether a database takes changes, asked by one that leaves nothing behind.

A database that is full, read-only, locked by another program or without tables still answers, and begins a transaction.
"""

from __future__ import annotations

import os
import time
from typing import Any, Final, cast

import sqlalchemy as sa
from sqlalchemy.engine import Connection

from lidarcodec_server.store.tables import audit, desired, facts, tokens

ENTRY_BYTES: Final = 16_384
"""More than what is free in the pages that a table has; at random, so that it cannot be compressed."""


def try_a_change(connection: Connection) -> None:
    """Write an entry to the audit log and delete it, and lock the other tables as a change does.

    Raises what the database raises; so may the end of the transaction.
    """
    for table in (desired, tokens, facts):
        connection.execute(sa.delete(table).where(sa.false()))
    values = {"vehicle": "", "sensor": "", "at_ns": time.time_ns(), "who": "", "action": "try", "result": "try"}
    filling = os.urandom(ENTRY_BYTES // 2).hex()
    made = connection.execute(sa.insert(audit).values(**values, changes={}, reason=filling))
    connection.execute(sa.delete(audit).where(audit.c.id == cast(Any, made.inserted_primary_key)[0]))

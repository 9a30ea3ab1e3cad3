"""The store's schema, step by step. `upgrade` takes any earlier state to the newest.

An empty database gets the newest schema at once, and a database with the newest schema is not changed. Alembic is
loaded only for older schemas, because loading it is slow.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from sqlalchemy import Column, Connection, MetaData, String, Table, insert, inspect, select, text

from lidarcodec.errors import LidarCodecError
from lidarcodec_server.store.tables import metadata

if TYPE_CHECKING:
    from alembic.config import Config


class StoreError(LidarCodecError):
    """The server's store cannot be opened, read or written."""


LOCK = 0x11DA2C0DEC
"""PostgreSQL advisory lock: two servers that start at once do not migrate at once."""
NEWEST: Final = "0001"
"""The newest of `versions`."""
VERSION = Table("alembic_version", MetaData(), Column("version_num", String(32), nullable=False, primary_key=True))
"""Alembic's table of the schema version."""


def configuration(connection: Connection | None = None) -> Config:
    """Alembic's configuration. connection: the connection for the migrations"""
    from alembic.config import Config

    config = Config()
    config.set_main_option("script_location", "lidarcodec_server:migrations")
    config.attributes["connection"] = connection
    return config


def upgrade(connection: Connection) -> None:
    """Bring the schema up to date, in the connection's transaction.

    Raises StoreError if a newer version of this program wrote it.
    """
    if connection.dialect.name == "postgresql":
        connection.execute(text("SELECT pg_advisory_xact_lock(:lock)"), {"lock": LOCK})
    there = inspect(connection).get_table_names()
    if not there:
        metadata.create_all(connection)
        VERSION.create(connection)
        connection.execute(insert(VERSION).values(version_num=NEWEST))
        return
    found = set(connection.scalars(select(VERSION.c.version_num))) if VERSION.name in there else set()
    if found != {NEWEST}:
        _step_by_step(connection, found)


def _step_by_step(connection: Connection, found: set[str]) -> None:
    from alembic import command
    from alembic.script import ScriptDirectory

    config = configuration(connection)
    known = {script.revision for script in ScriptDirectory.from_config(config).walk_revisions()}
    if unknown := found - known:
        raise StoreError(
            f"the database {connection.engine.url.render_as_string()} was written by a newer lidarcodec (schema "
            f"{', '.join(sorted(unknown))}): use that version, or name another database with --database-url"
        )
    command.upgrade(config, "head")

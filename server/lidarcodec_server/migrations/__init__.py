"""The store's schema, step by step. `upgrade` takes any earlier state to the newest."""

from __future__ import annotations

from alembic import command
from alembic.config import Config
from alembic.runtime.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import Connection, text

from lidarcodec.errors import LidarCodecError


class StoreError(LidarCodecError):
    """The server's store cannot be opened, read or written."""


LOCK = 0x11DA2C0DEC
"""PostgreSQL advisory lock: two servers that start at once do not migrate at once."""


def configuration(connection: Connection | None = None) -> Config:
    """Alembic's configuration; it works on a connection that is given to it."""
    config = Config()
    config.set_main_option("script_location", "lidarcodec_server:migrations")
    config.attributes["connection"] = connection
    return config


def upgrade(connection: Connection) -> None:
    """Bring the schema up to date, in the connection's transaction.

    Raises StoreError when a newer version of this program wrote it.
    """
    if connection.dialect.name == "postgresql":
        connection.execute(text("SELECT pg_advisory_xact_lock(:lock)"), {"lock": LOCK})
    config = configuration(connection)
    found = MigrationContext.configure(connection).get_current_heads()
    known = {script.revision for script in ScriptDirectory.from_config(config).walk_revisions()}
    if unknown := set(found) - known:
        raise StoreError(
            f"the database has schema {', '.join(sorted(unknown))}, which this version does not know: "
            "it was written by a newer lidarcodec; use that one, or another database"
        )
    command.upgrade(config, "head")

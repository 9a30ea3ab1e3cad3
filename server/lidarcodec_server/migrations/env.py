"""Alembic runs this: the migrations, on the connection of its configuration."""

from __future__ import annotations

from alembic import context

from lidarcodec_server.store.tables import metadata

context.configure(
    connection=context.config.attributes["connection"],
    target_metadata=metadata,
    compare_type=True,
    transactional_ddl=True,
)
with context.begin_transaction():
    context.run_migrations()

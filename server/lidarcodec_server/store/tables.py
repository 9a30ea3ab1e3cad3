"""The tables of the store. A change here needs a migration; a test compares the two."""

from __future__ import annotations

from sqlalchemy import JSON, BigInteger, Column, Index, Integer, MetaData, String, Table, Text

metadata = MetaData(
    naming_convention={
        "pk": "pk_%(table_name)s",
        "uq": "uq_%(table_name)s_%(column_0_name)s",
        "ix": "ix_%(table_name)s_%(column_0_name)s",
    }
)

_Id = BigInteger().with_variant(Integer, "sqlite")  # SQLite numbers only INTEGER columns automatically

tokens = Table(
    "tokens",
    metadata,
    Column("id", _Id, primary_key=True, autoincrement=True),
    Column("name", String(64), nullable=False, unique=True),
    Column("role", String(16), nullable=False),
    Column("digest", String(64), nullable=False, unique=True),
    Column("created_ns", BigInteger, nullable=False),
    Column("revoked_ns", BigInteger, nullable=True),
)
"""digest: SHA-256 of the token, hexadecimal."""

facts = Table(
    "facts",
    metadata,
    Column("name", String(32), primary_key=True),
    Column("at_ns", BigInteger, nullable=False),
)
"""Facts about a server, with the time since when they hold, such as `tokens-needed`."""

desired = Table(
    "desired",
    metadata,
    Column("vehicle", String(64), primary_key=True),
    Column("sensor", String(64), primary_key=True),
    Column("settings", JSON, nullable=False),
    Column("updated_ns", BigInteger, nullable=False),
)
"""settings: the settings that operators set, and the codec to which they belong."""

audit = Table(
    "audit",
    metadata,
    Column("id", _Id, primary_key=True, autoincrement=True),
    Column("vehicle", String(64), nullable=False),
    Column("sensor", String(64), nullable=False),
    Column("at_ns", BigInteger, nullable=False),
    Column("who", String(64), nullable=False),
    Column("action", String(16), nullable=False),
    Column("changes", JSON, nullable=False),
    Column("old", JSON, nullable=True),
    Column("new", JSON, nullable=True),
    Column("result", String(16), nullable=False),
    Column("reason", Text, nullable=True),
    Column("first_frame", BigInteger, nullable=True),
    Index("ix_audit_stream", "vehicle", "sensor", "id"),
)

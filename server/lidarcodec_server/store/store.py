"""Store: the data that survives a restart: tokens, the settings that operators want, and the audit log.

Any SQLAlchemy URL works; SQLite and PostgreSQL are tested. Every method is one transaction, blocks, and raises
StoreError. Its text never contains a password.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from typing import Any, NamedTuple, cast

import sqlalchemy as sa
from sqlalchemy.engine import Connection
from sqlalchemy.exc import ArgumentError, DBAPIError, IntegrityError, SQLAlchemyError

from lidarcodec.errors import SettingsError
from lidarcodec.transport.keys import StreamKeys
from lidarcodec_server.limits import SparseLog
from lidarcodec_server.migrations import StoreError, upgrade
from lidarcodec_server.store import database_file
from lidarcodec_server.store.engine import engine_of
from lidarcodec_server.store.patience import Patience
from lidarcodec_server.store.storable import storable
from lidarcodec_server.store.tables import audit, desired, facts, tokens
from lidarcodec_server.store.trial import try_a_change
from lidarcodec_server.store.wanted import ChangedError, keep, read, undone

logger = logging.getLogger(__name__)

NEEDED = "tokens-needed"
PRUNE_EVERY = 256
"""Number of entries between two checks of the length of the audit log."""


class Token(NamedTuple):
    """A stored token: only its digest, never the token itself."""

    name: str
    role: str
    digest: str
    created_ns: int
    revoked_ns: int | None


class Entry(NamedTuple):
    """An entry of the audit log. vehicle, sensor: empty if it is not about a stream"""

    id: int
    vehicle: str
    sensor: str
    at_ns: int
    who: str
    action: str
    changes: dict[str, Any]
    old: dict[str, Any] | None
    new: dict[str, Any] | None
    result: str
    reason: str | None
    first_frame: int | None


class Store:
    """The database of a server. Thread-safe."""

    def __init__(self, url: str, *, max_streams: int = 256, audit_rows: int = 1_000_000) -> None:
        """Raises SettingsError for an invalid URL, or if the driver of the database is not installed."""
        self._max_streams, self._audit_rows, self._written = max_streams, audit_rows, 0
        self._warnings = SparseLog(logger)
        try:
            parsed = sa.make_url(url)
            if parsed.drivername in ("postgres", "postgresql"):
                parsed = parsed.set(drivername="postgresql+psycopg")
            self.name = parsed.render_as_string(hide_password=True)
            self._engine = engine_of(parsed)
            self._patience = None if parsed.get_backend_name() == "sqlite" else Patience()
            self._file = database_file.file_of(parsed)
            self._opened: database_file.Opened | None = None
            self._following = threading.Lock()
            self._write_failed = False
        except ArgumentError:  # its text may contain the password
            raise SettingsError(
                "the database URL is not valid: write for example sqlite:///server.db", "database_url"
            ) from None
        except ImportError as error:
            raise SettingsError(f"the driver of {self.name} is not installed: {error}", "database_url") from None

    def open(self, *, create: bool = True) -> None:
        """Connect, and bring the schema up to date. create: make the file if it does not exist

        Raises StoreError.
        """
        file = self._file
        if file is not None:
            if not create and not file.exists():
                raise StoreError(f"there is no database {file}: `serve` and `token create` create one")
            database_file.make(file)
        self._upgrade()
        if file is not None:
            self._opened = database_file.opened(file)

    def close(self) -> None:
        """Close all connections."""
        self._engine.dispose()

    def ready(self) -> bool:
        """Whether the database answers; after a failed change, whether it accepts changes again."""
        try:
            if self._write_failed:
                with self._writing() as connection:
                    try_a_change(connection)
            else:
                with self._reading() as connection:
                    connection.execute(sa.select(sa.literal(1)))
        except StoreError:
            return False
        return True

    # --- tokens -----------------------------------------------------------------------------------------------------

    def tokens(self) -> list[Token]:
        """All tokens that were ever made, including revoked ones, oldest first."""
        columns = [tokens.c[name] for name in Token._fields]
        with self._reading() as connection:
            return [Token(*row) for row in connection.execute(sa.select(*columns).order_by(tokens.c.id))]

    def add_token(self, name: str, role: str, digest: str, who: str = "") -> None:
        """Store a new token.

        Raises SettingsError if the name was used before: names in the audit log must stay unambiguous.
        """
        values = {"name": name, "role": role, "digest": digest, "created_ns": time.time_ns()}
        try:
            with self._writing() as connection:
                connection.execute(sa.insert(tokens).values(values))
                self._need(connection)
                self._enter(connection, None, who, "token-create", {"token": name, "role": role}, None, result="done")
        except _TakenError:
            raise SettingsError(f"a token '{name}' exists or existed before: choose another name", "name") from None
        self._write_note()

    def revoke_token(self, name: str, who: str = "") -> bool:
        """Revoke a token. False if there is no valid token of that name."""
        change = sa.update(tokens).where(tokens.c.name == name, tokens.c.revoked_ns.is_(None))
        with self._writing() as connection:
            if connection.execute(change.values(revoked_ns=time.time_ns())).rowcount != 1:
                return False
            self._enter(connection, None, who, "token-revoke", {"token": name}, None, result="done")
            return True

    def tokens_needed(self) -> bool:
        """Whether a token was ever needed here, even if all tokens, or the whole database, were deleted since."""
        if self._file is not None and database_file.note_of(self._file).exists():
            return True
        with self._reading() as connection:
            return connection.execute(sa.select(facts.c.name).where(facts.c.name == NEEDED)).first() is not None

    def need_tokens(self) -> None:
        """Note that tokens are needed from now on, even when all are revoked."""
        with self._writing() as connection:
            self._need(connection)
        self._write_note()

    def forget_needed(self, who: str) -> None:
        """Allow access without a token again until a token is made. This gets an entry in the audit log."""
        if not self.tokens_needed():
            return
        with self._writing() as connection:
            connection.execute(sa.delete(facts).where(facts.c.name == NEEDED))
            self._enter(connection, None, who, "open", {}, None, result="done")
        if self._file is not None:
            database_file.remove_note(self._file)

    # --- settings that operators want -------------------------------------------------------------------------------

    def desired(self, keys: StreamKeys) -> dict[str, Any]:
        """The settings that operators set for a stream; empty if there are none."""
        with self._reading() as connection:
            return read(connection, keys, self._warnings)

    def all_desired(self) -> list[StreamKeys]:
        """The streams with settings of operators, sorted by name."""
        query = sa.select(desired.c.vehicle, desired.c.sensor).order_by(desired.c.vehicle, desired.c.sensor)
        with self._reading() as connection:
            return [StreamKeys(*row) for row in connection.execute(query)]

    def begin(
        self,
        keys: StreamKeys,
        who: str,
        action: str,
        changes: dict[str, Any],
        old: dict[str, Any] | None,
        wanted: dict[str, Any] | None = None,
        before: dict[str, Any] | None = None,
    ) -> int:
        """Write an audit entry for a change that is about to happen, and store the wanted settings, if given.
        Returns the entry's id. An empty `wanted` deletes the stored settings.

        before: the settings to which the change was made
        Raises ChangedError if another server has changed them since, SettingsError if the limit of streams with stored
        settings is reached.
        """
        with self._writing() as connection:
            if before is not None and before != self._wanted(connection, keys):
                raise ChangedError("another server has changed these settings")
            try:
                if wanted is not None:
                    keep(connection, keys, wanted, self._max_streams)
            except ChangedError:
                if before is not None or wanted is None:
                    raise
                keep(connection, keys, wanted, self._max_streams)
            return self._enter(connection, keys, who, action, changes, old, result="sent")

    def note(
        self,
        keys: StreamKeys | None,
        who: str,
        action: str,
        changes: dict[str, Any],
        old: dict[str, Any] | None = None,
        **outcome: Any,
    ) -> int:
        """Write an audit entry for something that has happened. Returns its id. outcome: `result`, and `new`, `reason`,
        `first_frame`
        """
        with self._writing() as connection:
            return self._enter(connection, keys, who, action, changes, old, **outcome)

    def recount(self, entry: int, changes: dict[str, Any]) -> None:
        """Update the count in an entry of the audit log."""
        with self._writing() as connection:
            connection.execute(sa.update(audit).where(audit.c.id == entry).values(changes=storable(changes)))

    def finish(
        self,
        entry: int,
        result: str,
        new: dict[str, Any] | None = None,
        reason: str | None = None,
        first_frame: int | None = None,
        restore: tuple[StreamKeys, dict[str, Any], dict[str, Any]] | None = None,
    ) -> None:
        """Write the result of a change into its entry. restore: the wanted settings of before, which are restored, and
        those with the change
        """
        values: dict[str, Any] = {"result": result, "reason": storable(reason), "first_frame": first_frame}
        values["new"] = sa.null() if new is None else storable(new)
        with self._writing() as connection:
            connection.execute(sa.update(audit).where(audit.c.id == entry).values(values))
            if restore is not None:
                keys, before, wanted = restore
                now = undone(self._wanted(connection, keys), wanted, before)
                keep(connection, keys, now, self._max_streams)

    def audit(self, keys: StreamKeys | None, limit: int = 100, before: int | None = None) -> list[Entry]:
        """Entries of a stream, newest first; without `keys` all entries. before: id of the last entry of the previous
        page
        """
        query = sa.select(*[audit.c[name] for name in Entry._fields])
        if keys is not None:
            query = query.where(audit.c.vehicle == keys.vehicle, audit.c.sensor == keys.sensor)
        if before is not None:
            query = query.where(audit.c.id < before)
        with self._reading() as connection:
            return [Entry(*row) for row in connection.execute(query.order_by(audit.c.id.desc()).limit(limit))]

    # --- inside a transaction ---------------------------------------------------------------------------------------

    def _need(self, connection: Connection) -> None:
        if connection.execute(sa.select(facts.c.name).where(facts.c.name == NEEDED)).first() is None:
            connection.execute(sa.insert(facts).values(name=NEEDED, at_ns=time.time_ns()))

    def _write_note(self) -> None:
        """Called after the transaction: if a token could not be stored, it must not lock the server."""
        if self._file is not None:
            database_file.write_note(self._file)

    def _wanted(self, connection: Connection, keys: StreamKeys) -> dict[str, Any]:
        return read(connection, keys, self._warnings, to_change=True)

    def _enter(
        self,
        connection: Connection,
        keys: StreamKeys | None,
        who: str,
        action: str,
        changes: dict[str, Any],
        old: dict[str, Any] | None,
        new: dict[str, Any] | None = None,
        **outcome: Any,
    ) -> int:
        vehicle, sensor = ("", "") if keys is None else (keys.vehicle, keys.sensor)
        values = {"vehicle": vehicle, "sensor": sensor, "at_ns": time.time_ns(), "who": who[:64]}
        values |= {"action": action, "changes": changes, "old": old, "new": new, **outcome}
        values = {name: storable(value) for name, value in values.items()}
        values |= {name: sa.null() for name in ("old", "new") if values[name] is None}
        made = connection.execute(sa.insert(audit).values(values))
        self._prune(connection)
        return int(cast(Any, made.inserted_primary_key)[0])

    def _prune(self, connection: Connection) -> None:
        self._written += 1
        if self._written % PRUNE_EVERY == 1:
            newest = connection.execute(sa.select(sa.func.max(audit.c.id))).scalar_one()
            connection.execute(sa.delete(audit).where(audit.c.id <= newest - self._audit_rows))

    @contextmanager
    def _reading(self) -> Iterator[Connection]:
        self._follow_file()
        with self._errors(), self._engine.begin() as connection:
            yield connection

    @contextmanager
    def _writing(self) -> Iterator[Connection]:
        try:
            self._follow_file()
            with self._transaction() as connection:
                yield connection
        except StoreError as error:
            self._write_failed = not isinstance(error, _TakenError)
            raise
        self._write_failed = False

    @contextmanager
    def _transaction(self) -> Iterator[Connection]:
        with self._errors(), self._engine.connect() as connected:
            connection = connected.execution_options(writes=True)
            with connection.begin():
                yield connection

    def _upgrade(self) -> None:
        with self._transaction() as connection:
            upgrade(connection)

    def _follow_file(self) -> None:
        """Use the file that has the database's name now: changes in a removed file would be lost.

        Raises StoreError if there is no such file, or it cannot be used.
        """
        if self._file is None or self._opened is None:
            return
        with self._following:
            found = database_file.opened(self._file)
            if found is None:
                raise StoreError(f"the database {self._file} was removed: restore it, or restart to create a new one")
            if found.database == self._opened.database:
                self._opened = found
                return
            self._engine.dispose()
            database_file.remove_log(self._file, self._opened)
            self._upgrade()
            self._opened = database_file.opened(self._file)
            logger.warning("the database at %s was replaced; the new one is now in use", self._file)

    @contextmanager
    def _errors(self) -> Iterator[None]:
        try:
            with nullcontext() if self._patience is None else self._patience.asking(_RestsError):
                yield
        except IntegrityError:
            raise _TakenError("this name is already used") from None
        except _RestsError as error:
            raise StoreError(f"the database {self.name} failed: {error}") from None
        except SQLAlchemyError as error:
            reason = error.orig if isinstance(error, DBAPIError) else error
            raise StoreError(f"the database {self.name} failed: {' '.join(str(reason).split())}") from None


class _RestsError(Exception):
    """The database did not answer, and is not asked for a short time."""


class _TakenError(StoreError):
    """There is already a row with this name."""

"""What has to survive: lose it, and a fleet drives with the wrong settings and nobody knows who changed them."""

from __future__ import annotations

import contextlib
import os
import pwd
import shutil
import signal
import socket
import sqlite3
import subprocess
import tempfile
import threading
from contextlib import closing
from pathlib import Path

import pytest
import sqlalchemy as sa
from alembic import command
from alembic.autogenerate import compare_metadata
from alembic.runtime.migration import MigrationContext

from lidarcodec.errors import SettingsError
from lidarcodec.transport.keys import StreamKeys
from lidarcodec_server.migrations import NEWEST, StoreError, configuration, upgrade
from lidarcodec_server.store import engine as engine_module
from lidarcodec_server.store.store import Store
from lidarcodec_server.store.tables import audit, metadata
from lidarcodec_server.tokens import TokenBook, create_token
from tests.server.conftest import until
from tests.transport.conftest import free_port
from tests.transport.test_contract import eventually

CAR = StreamKeys("car-7", "roof")
POSTGRES_FOLDERS = ("/usr/lib/postgresql/15/bin", "/usr/local/bin", "/usr/bin")


def postgres_program(name: str) -> str | None:
    """A program of PostgreSQL's server, wherever it is."""
    return shutil.which(name) or shutil.which(name, path=os.pathsep.join(POSTGRES_FOLDERS))


@pytest.fixture(scope="module")
def postgres():
    """URL of a real PostgreSQL, started for these tests; skips by name where there is none."""
    programs = [postgres_program(name) for name in ("initdb", "postgres")]
    if None in programs:
        pytest.skip("needs PostgreSQL's initdb and postgres")
    folder = Path(tempfile.mkdtemp(prefix="postgres-"))  # pytest's folders are closed to others
    as_user: dict[str, str] = {}
    if os.geteuid() == 0:  # it refuses to run as root
        try:
            pwd.getpwnam("postgres")
        except KeyError:
            pytest.skip("needs a user postgres: PostgreSQL does not run as root")
        as_user = {"user": "postgres", "group": "postgres", "extra_groups": []}
        shutil.chown(folder, "postgres")
    data = folder / "data"
    initdb, server = ([program] for program in programs)
    initdb += ["-D", str(data), "-U", "ada", "-A", "trust", "-N", "-E", "UTF8", "--no-locale"]
    subprocess.run(initdb, check=True, capture_output=True, cwd="/", **as_user)
    port = free_port()
    server += ["-D", str(data), "-p", str(port), "-c", "fsync=off", "-c", f"unix_socket_directories={folder}"]
    log = (folder / "log").open("wb")
    process = subprocess.Popen(server, stdout=log, stderr=log, cwd="/", **as_user, env={"LC_ALL": "C"})
    log.close()
    url = f"postgresql://ada:secret@127.0.0.1:{port}/postgres"
    try:
        engine = sa.create_engine(url.replace("postgresql:", "postgresql+psycopg:"))

        def ready() -> bool:
            with contextlib.suppress(sa.exc.OperationalError), engine.connect():
                return True
            return process.poll() is not None

        assert eventually(ready)
        engine.dispose()
        assert process.poll() is None, (folder / "log").read_text()
        yield url
        assert process.poll() is None, (folder / "log").read_text()
    finally:
        process.send_signal(signal.SIGINT)  # does not wait for connections
        process.wait(60)
        shutil.rmtree(folder)


@pytest.fixture(params=["sqlite", "postgres"])
def url(request, tmp_path):
    """An empty database of each kind."""
    if request.param == "sqlite":
        return f"sqlite:///{tmp_path / 'server.db'}"
    found = request.getfixturevalue("postgres")
    engine = sa.create_engine(found.replace("postgresql:", "postgresql+psycopg:"))
    with engine.begin() as connection:
        connection.execute(sa.text("DROP SCHEMA public CASCADE"))
        connection.execute(sa.text("CREATE SCHEMA public"))
    engine.dispose()
    return found


@pytest.fixture
def store(url):
    found = Store(url)
    found.open()
    yield found
    found.close()


def test_what_is_wanted_is_there_after_a_restart(url, store):
    entry = store.begin(CAR, "otto", "settings", {"codec": "raw"}, None, {"codec": "raw", "max_error_m": None})
    store.finish(entry, "applied", {"codec": "raw"}, first_frame=2**40)
    store.close()
    again = Store(url)
    again.open()
    assert again.desired(CAR) == {"codec": "raw", "max_error_m": None}
    assert again.all_desired() == [CAR]
    (found,) = again.audit(CAR)
    assert (found.who, found.changes, found.old, found.new) == ("otto", {"codec": "raw"}, None, {"codec": "raw"})
    assert (found.result, found.first_frame) == ("applied", 2**40)
    assert again.audit(StreamKeys("car-8", "roof")) == []
    again.close()


def test_a_refused_change_leaves_what_was_wanted_before(store):
    store.finish(store.begin(CAR, "otto", "settings", {}, None, {"codec": "raw"}), "applied")
    entry = store.begin(CAR, "otto", "settings", {}, None, {"codec": "jxl"})
    assert store.desired(CAR) == {"codec": "jxl"}
    store.finish(entry, "refused", reason="no", restore=(CAR, {"codec": "raw"}, {"codec": "jxl"}))
    assert store.desired(CAR) == {"codec": "raw"}
    first = store.begin(StreamKeys("new", "roof"), "otto", "settings", {}, None, {"codec": "jxl"})
    store.finish(first, "refused", restore=(StreamKeys("new", "roof"), {}, {"codec": "jxl"}))
    assert store.all_desired() == [CAR]


def test_the_audit_log_is_bounded_and_the_oldest_go(url):
    store = Store(url, audit_rows=10)
    store.open()
    for number in range(257 + 5):
        store.begin(CAR, "otto", "settings", {"key_interval": number + 1}, None)
    kept = [entry.changes["key_interval"] for entry in store.audit(CAR, 1000)]
    assert kept[0] == 262
    assert len(kept) <= 10 + 5
    store.close()


def schema(connection) -> dict:
    """What a database holds, by name: tables, columns, keys and indices."""
    found = sa.inspect(connection)
    return {
        table: (
            [(column["name"], str(column["type"]), column["nullable"]) for column in found.get_columns(table)],
            found.get_pk_constraint(table),
            sorted(map(str, found.get_unique_constraints(table))),
            sorted(map(str, found.get_indexes(table))),
        )
        for table in found.get_table_names()
    }


def test_migrations_lead_from_nothing_to_what_an_empty_database_gets_at_once_and_back(store):
    """Else the next migration would find something else in a new database than in an old one."""
    with store._engine.connect() as connection:
        at_once = schema(connection)
        assert newest(connection) == NEWEST
        connection.rollback()
        with connection.begin():
            command.downgrade(configuration(connection), "base")
            left = set(sa.inspect(connection).get_table_names()) - {"alembic_version"}
            assert left == set()
            upgrade(connection)
            assert newest(connection) == NEWEST
            assert schema(connection) == at_once
            context = MigrationContext.configure(connection, opts={"compare_type": True, "target_metadata": metadata})
            assert compare_metadata(context, metadata) == []


def newest(connection) -> str | None:
    """The last migration that a database has had."""
    return MigrationContext.configure(connection).get_current_revision()


def test_opening_twice_changes_nothing(url, store):
    create_token(store, "ada", "viewer")
    again = Store(url)
    again.open()
    assert [token.name for token in again.tokens()] == ["ada"]
    again.close()


def test_servers_that_start_at_once_do_not_hurt_each_other(url):
    stores, errors = [Store(url) for _ in range(4)], []

    def start(store):
        try:
            store.open()
        except StoreError as error:
            errors.append(error)

    threads = [threading.Thread(target=start, args=(store,)) for store in stores]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert errors == []
    assert stores[0].tokens() == []
    for store in stores:
        store.close()


def test_writers_at_once_lose_nothing(store):
    def write(number):
        for turn in range(10):
            store.begin(CAR, f"n{number}", "settings", {"turn": turn}, None, {"key_interval": turn + 1})

    threads = [threading.Thread(target=write, args=(number,)) for number in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(store.audit(CAR, 1000)) == 40


def test_a_schema_of_a_newer_version_is_refused_and_not_touched(url, store):
    with store._engine.begin() as connection:
        connection.execute(sa.text("UPDATE alembic_version SET version_num = '9999'"))
    again = Store(url)
    with pytest.raises(StoreError, match=r"newer.*9999"):
        again.open()
    again.close()
    with store._engine.begin() as connection:
        assert connection.execute(sa.text("SELECT version_num FROM alembic_version")).scalar_one() == "9999"


@pytest.mark.parametrize("url_", ["nonsense", "nodb://x/y", "mysql+nosuchdriver://x/y", ""])
def test_what_is_no_database_url_is_reported(url_):
    with pytest.raises(SettingsError):
        Store(url_)


def test_a_database_that_cannot_be_reached_is_reported_without_the_password():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        store = Store(f"postgresql://ada:swordfish@127.0.0.1:{probe.getsockname()[1]}/fleet")
        with pytest.raises(StoreError) as caught:
            store.open()
    assert "swordfish" not in str(caught.value)
    assert "127.0.0.1" in str(caught.value)
    store.close()


def test_a_folder_that_is_not_there_is_made_and_one_that_cannot_be_is_reported(tmp_path):
    store = Store(f"sqlite:///{tmp_path / 'a' / 'b' / 'server.db'}")
    store.open()
    store.close()
    (tmp_path / "file").write_text("")
    blocked = Store(f"sqlite:///{tmp_path / 'file' / 'server.db'}")
    with pytest.raises(StoreError):
        blocked.open()


def test_a_database_that_is_removed_under_a_server_keeps_nothing_in_silence(tmp_path, caplog):
    store = Store(f"sqlite:///{tmp_path / 'server.db'}")
    store.open()
    create_token(store, "ada", "viewer")
    shutil.copy(tmp_path / "server.db", tmp_path / "backup.db")
    (tmp_path / "server.db").rename(tmp_path / "aside.db")
    with pytest.raises(StoreError, match="was removed"):
        store.begin(CAR, "ada", "settings", {}, None, {"codec": "raw"})
    assert not store.ready()
    (tmp_path / "backup.db").rename(tmp_path / "server.db")
    assert store.ready()
    assert store.desired(CAR) == {}
    assert "was replaced; the new one is now in use" in caplog.text
    store.close()


@pytest.mark.sweep
def test_a_backup_that_is_put_in_place_under_a_server_is_what_is_used(tmp_path):
    """Pages in the write-ahead log of the old database would be read as those of the backup, and ruin it."""
    file, backup = tmp_path / "server.db", tmp_path / "backup.db"
    store = Store(f"sqlite:///{file}")
    store.open()
    create_token(store, "mal", "viewer")
    for _ in range(1200):  # more than one checkpoint
        store.note(CAR, "first", "settings", {"codec": "raw"}, result="applied")
    with closing(sqlite3.connect(file)) as copy:
        copy.execute("VACUUM INTO ?", (str(backup),))
    for _ in range(100):
        store.note(CAR, "second", "settings", {"codec": "raw"}, result="applied")
    assert store.revoke_token("mal")
    backup.rename(file)
    store.note(CAR, "third", "settings", {"codec": "raw"}, result="applied")
    assert [token.revoked_ns for token in store.tokens()] == [None]
    assert [entry.who for entry in store.audit(CAR, 2)] == ["third", "first"]
    with closing(sqlite3.connect(file)) as looked_at:
        assert looked_at.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
    store.close()


def test_an_empty_file_in_the_place_of_the_database_gets_its_schema(tmp_path):
    file = tmp_path / "server.db"
    store = Store(f"sqlite:///{file}")
    store.open()
    (tmp_path / "empty.db").touch()
    (tmp_path / "empty.db").rename(file)
    store.begin(CAR, "ada", "settings", {}, None, {"codec": "raw"})
    assert store.desired(CAR) == {"codec": "raw"}
    store.close()


def test_a_database_that_is_none_is_not_ready(tmp_path):
    file = tmp_path / "server.db"
    store = Store(f"sqlite:///{file}")
    store.open()
    (tmp_path / "other.db").write_bytes(b"no database " * 1000)
    (tmp_path / "other.db").rename(file)
    with pytest.raises(StoreError, match="not a database"):
        store.begin(CAR, "ada", "settings", {}, None, {"codec": "raw"})
    assert not store.ready()
    store.close()


def test_a_database_that_takes_no_changes_is_not_ready(tmp_path, monkeypatch):
    monkeypatch.setattr(engine_module, "BUSY_S", 0.2)
    file = tmp_path / "server.db"
    store = Store(f"sqlite:///{file}")
    store.open()
    with closing(sqlite3.connect(file, isolation_level=None)) as other:
        other.execute("BEGIN EXCLUSIVE")
        with pytest.raises(StoreError, match="locked"):
            store.begin(CAR, "ada", "settings", {}, None, {"codec": "raw"})
        assert not store.ready()
        other.execute("ROLLBACK")
    assert store.ready()
    assert store.ready()
    store.close()


@pytest.mark.parametrize("table", ["audit", "desired"])
def test_a_postgresql_whose_table_is_locked_or_gone_is_not_ready(postgres, table, monkeypatch):
    """It begins a transaction and answers, so it was ready while each change was refused."""
    monkeypatch.setattr(engine_module, "BUSY_S", 1.0)
    engine = sa.create_engine(postgres.replace("postgresql:", "postgresql+psycopg:"))
    with engine.begin() as connection:
        connection.execute(sa.text("DROP SCHEMA public CASCADE"))
        connection.execute(sa.text("CREATE SCHEMA public"))
    store = Store(postgres)
    store.open()
    with engine.connect() as other:
        other.execute(sa.text(f"LOCK TABLE {table} IN ACCESS EXCLUSIVE MODE"))
        with pytest.raises(StoreError):
            store.begin(CAR, "ada", "settings", {}, None, {"codec": "raw"})
        assert not store.ready()
        other.rollback()
    eventually(store.ready)
    assert store.audit(CAR, 5) == []
    with engine.begin() as other:
        other.execute(sa.text(f"ALTER TABLE {table} RENAME TO elsewhere"))
    with pytest.raises(StoreError):
        store.begin(CAR, "ada", "settings", {}, None, {"codec": "raw"})
    assert not store.ready()
    with engine.begin() as other:
        other.execute(sa.text(f"ALTER TABLE elsewhere RENAME TO {table}"))
    eventually(store.ready)
    store.begin(CAR, "ada", "settings", {}, None, {"codec": "raw"})
    engine.dispose()
    store.close()


def test_a_database_that_cannot_grow_is_not_ready(tmp_path):
    """As on a full disk."""
    file = tmp_path / "server.db"
    store = Store(f"sqlite:///{file}")
    store.open()

    def sizes(connection, _):
        connection.execute("PRAGMA max_page_count = 1").close()  # SQLite takes what it has for the least

    store.close()
    sa.event.listen(store._engine, "connect", sizes)

    def fill():
        for _ in range(1000):
            store.note(CAR, "ada", "settings", {"codec": "raw" * 1000}, result="applied")

    with pytest.raises(StoreError, match="full"):
        fill()
    assert not store.ready()
    sa.event.remove(store._engine, "connect", sizes)
    store.close()
    assert store.ready()
    store.note(CAR, "ada", "settings", {"codec": "raw"}, result="applied")
    store.close()


def test_tokens_that_were_known_work_on_while_the_database_is_away(store, monkeypatch):
    token = create_token(store, "ada", "viewer")
    book = TokenBook(store)
    assert book.client(token).name == "ada"

    def away():
        raise StoreError("away")

    monkeypatch.setattr(store, "tokens", away)
    book._due = 0.0
    assert book.client(token).name == "ada"
    assert book.needed
    with pytest.raises(StoreError):
        TokenBook(store).needed  # noqa: B018


async def test_the_server_works_the_same_on_either_database(serving, vehicle, url):
    path = "/api/v1/streams/car-7/roof"
    async with serving(database_url=url) as client:
        assert (await client.patch(f"{path}/settings?prepare=true", json={"codec": "zstd"})).status_code == 202
        car = vehicle()

        async def follows():
            return car.settings.codec == "zstd"

        assert await until(follows)
        assert (await client.patch(f"{path}/settings", json={"intensity": "off"})).status_code == 200
        audit_log = (await client.get(f"{path}/audit")).json()
        assert [entry["result"] for entry in audit_log] == ["applied", "applied", "stored"]
        assert (await client.get(f"{path}/settings")).json()["operator"] == {"codec": "zstd", "intensity": "off"}


async def test_a_store_that_fails_is_a_problem_and_nothing_reaches_the_vehicle(serving, vehicle, monkeypatch):
    car = vehicle()
    async with serving() as client:
        service = client.app.state.service
        with service.store._engine.begin() as connection:
            audit.drop(connection)
        answer = await client.patch("/api/v1/streams/car-7/roof/settings", json={"codec": "raw"})
        assert answer.status_code == 503
        assert answer.json()["type"].endswith(":store")
        assert "audit" not in answer.text
        assert car.settings.codec == "pcodec"
        assert (await client.get("/api/v1/streams")).status_code == 200


@pytest.mark.sweep
async def test_readiness_says_which_part_is_missing(serving, monkeypatch):
    async with serving() as client:
        assert (await client.get("/readyz")).json() == {"zenoh": True, "store": True}
        monkeypatch.setattr(client.app.state.service.store, "ready", lambda: False)
        answer = await client.get("/readyz")
        assert (answer.status_code, answer.json()) == (503, {"zenoh": True, "store": False})
        assert (await client.get("/healthz")).status_code == 200

"""Once a token was needed, one is needed for good: a server must not open because its tokens were deleted."""

from __future__ import annotations

import contextlib
import os
import resource
import stat
from functools import partial

import pytest
import sqlalchemy as sa

from lidarcodec.errors import SettingsError
from lidarcodec_server.serve import check_open
from lidarcodec_server.store.database_file import note_of
from lidarcodec_server.store.store import Store
from lidarcodec_server.store.tables import facts, tokens
from lidarcodec_server.tokens import TokenBook, create_token
from tests.command_line import start
from tests.faults.serving import Server
from tests.server.conftest import until
from tests.transport.conftest import free_port
from tests.transport.test_contract import eventually


@pytest.fixture
def store(config):
    found = Store(config.database_url)
    found.open()
    yield found
    found.close()


def emptied(store, *tables):
    with store._engine.begin() as connection:
        for table in tables:
            connection.execute(sa.delete(table))


async def test_tokens_that_are_deleted_under_a_server_open_nothing(serving, store):
    token = create_token(store, "ada", "operator")
    async with serving(token) as client:
        assert (await client.get("/api/v1/streams")).status_code == 200
        emptied(store, tokens, facts)

        async def refused():
            return (await client.get("/api/v1/streams")).status_code == 401

        assert await until(refused)
        for method, path in (("GET", "/api/v1/streams"), ("PATCH", "/api/v1/streams/a/b/settings")):
            answer = await client.request(method, path, json={"codec": "raw"}, headers={"Authorization": ""})
            assert answer.status_code == 401
        session = (await client.get("/api/v1/session", headers={"Authorization": ""})).json()
        assert session["token_needed"]
        token = create_token(store, "otto", "operator")

        async def works():
            headers = {"Authorization": f"Bearer {token}"}
            return (await client.get("/api/v1/streams", headers=headers)).status_code == 200

        assert await until(works)


@pytest.mark.parametrize("left", ["the note", "the fact"])
def test_a_server_that_starts_without_the_tokens_that_there_were_lets_nobody_in(store, config, left):
    """Whether somebody deletes the tokens, or the whole file."""
    create_token(store, "ada", "operator")
    note = store._file.with_name("server.needs-tokens")
    if left == "the note":
        store.close()
        store._file.unlink()
        store = Store(config.database_url)
        store.open()
    else:
        emptied(store, tokens)
        note.unlink()
    assert TokenBook(store).needed
    check_open(config.model_copy(update={"host": "0.0.0.0"}))
    opened = TokenBook(store, opened=True)
    assert not opened.needed
    assert not note.exists()
    assert not TokenBook(store).needed, "it was opened for good, not for one start"
    create_token(store, "otto", "viewer")
    opened._due = 0.0
    assert opened.needed, "the next token closes it"
    store.close()


@pytest.mark.sweep
def test_a_token_that_cannot_be_kept_closes_nothing(store, config):
    """On a full disk: the first token was not made, and nobody got in any more, with or without one."""
    limit = (4096, resource.RLIM_INFINITY)  # no room for what changes, as on a full disk
    full = partial(resource.setrlimit, resource.RLIMIT_FSIZE, limit)
    words = ("token", "create", "ada", "--role", "operator", "--database-url", config.database_url)
    process = start(*words, preexec_fn=full)
    _, complaint = process.communicate(timeout=60)
    assert process.returncode == 1, complaint
    assert "disk" in complaint
    assert store.tokens() == []
    assert not TokenBook(store).needed
    assert not note_of(store._file).exists()


def test_revoked_tokens_open_nothing_unless_told_so_and_working_ones_never(store, config):
    create_token(store, "ada", "operator")
    outside = config.model_copy(update={"host": "0.0.0.0", "open": True})
    with pytest.raises(SettingsError, match="revoke them first"):
        TokenBook(store, opened=True).needed  # noqa: B018
    store.revoke_token("ada")
    assert TokenBook(store).needed
    with pytest.raises(SettingsError, match="token create"):
        check_open(outside)
    assert not TokenBook(store, opened=True).needed


def test_making_revoking_and_opening_are_in_the_audit_log(store):
    create_token(store, "ada", "operator", "root (command line)")
    store.revoke_token("ada", "root (command line)")
    assert not store.revoke_token("ada", "root (command line)")
    store.forget_needed("serve --open")
    entries = [(entry.action, entry.who, entry.changes) for entry in store.audit(None)]
    assert entries == [
        ("open", "serve --open", {}),
        ("token-revoke", "root (command line)", {"token": "ada"}),
        ("token-create", "root (command line)", {"token": "ada", "role": "operator"}),
    ]


def test_nobody_else_may_read_the_database(tmp_path):
    old = os.umask(0o022)
    try:
        file = tmp_path / "new" / "server.db"
        store = Store(f"sqlite:///{file}")
        store.open()
        create_token(store, "ada", "viewer")
        modes = {one.name: stat.S_IMODE(one.stat().st_mode) for one in file.parent.iterdir()}
        assert {name for name in modes if name.startswith("server.db")} >= {"server.db", "server.db-wal"}
        assert {mode for name, mode in modes.items() if name.startswith("server.db")} == {0o600}
        assert stat.S_IMODE(file.parent.stat().st_mode) == 0o700
        store.close()
        file.chmod(0o644)
        store = Store(f"sqlite:///{file}")
        store.open()
        assert stat.S_IMODE(file.stat().st_mode) == 0o600
        store.close()
    finally:
        os.umask(old)


@pytest.mark.timeout(150)
@pytest.mark.sweep
def test_a_database_that_is_deleted_under_a_process_opens_neither_it_nor_the_next_one(tmp_path):
    first, second = (Server(tmp_path, free_port(), free_port()) for _ in range(2))
    store = Store(f"sqlite:///{tmp_path / 'server.db'}")
    store.open()
    create_token(store, "ada", "operator")
    store.close()
    with contextlib.ExitStack() as stack:
        for server in (first, second):
            stack.callback(server.kill)
        first.start()
        assert first.ask("/api/v1/streams")[0] == 401
        for file in tmp_path.glob("server.db*"):
            file.unlink()
        second.start()
        for _ in range(3):
            assert [server.ask("/api/v1/streams")[0] for server in (first, second)] == [401, 401]
            assert second.ask("/api/v1/streams/a/b/settings", "PATCH", {"codec": "raw"})[0] == 401
            assert eventually(lambda: second.ask("/healthz")[0] == 200)

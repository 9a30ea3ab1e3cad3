"""A database that stands still, or is cut off, holds up nobody who needs nothing of it."""

from __future__ import annotations

import contextlib
import socket
import threading
import time

import pytest
import sqlalchemy as sa

from lidarcodec_server.migrations import StoreError
from lidarcodec_server.store.store import Store
from lidarcodec_server.tokens import Client, TokenBook, create_token
from tests.calm import Calm
from tests.server.conftest import until
from tests.server.test_store import postgres

__all__ = ["postgres"]


class Relay:
    """Passes bytes on to a database until it is told to hold them; connections stay open."""

    def __init__(self, port: int) -> None:
        self._port, self.holds = port, threading.Event()
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]
        self._held: list[socket.socket] = [self._listener]
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                near, far = self._listener.accept()[0], socket.create_connection(("127.0.0.1", self._port))
                self._held += [near, far]
                for ends in ((near, far), (far, near)):
                    threading.Thread(target=self._pass_on, args=ends, daemon=True).start()

    def _pass_on(self, come: socket.socket, go: socket.socket) -> None:
        with contextlib.suppress(OSError):
            while data := come.recv(65536):
                while self.holds.is_set():
                    time.sleep(0.05)
                go.sendall(data)
            go.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        self.holds.clear()
        for one in self._held:
            one.close()


@pytest.fixture
def relay(postgres):
    """Between the server and PostgreSQL; and the URL of the database behind it."""
    url = sa.make_url(postgres)
    found = Relay(url.port)
    yield found, url.set(port=found.port).render_as_string(hide_password=False)
    found.close()


@pytest.mark.timeout(120)
@pytest.mark.sweep
async def test_a_database_that_stands_still_holds_up_nobody(serving, relay):
    """Streams are shown, tokens that were known work, changes are refused; and all is well when it goes on."""
    between, url = relay
    store = Store(url)
    store.open()
    token = create_token(store, "ada", "operator")
    store.close()
    async with serving(token, database_url=url) as client:
        assert (await client.get("/api/v1/streams")).status_code == 200
        between.holds.set()
        with contextlib.suppress(StoreError):
            client.app.state.service.store.tokens()  # the first to notice
        for _ in range(3):
            with Calm() as calm:
                begin = time.monotonic()
                answer = await client.get("/api/v1/streams")
                assert (answer.status_code, answer.json()) == (200, [])
                refused = await client.patch("/api/v1/streams/car-7/roof/settings?prepare=true", json={"codec": "raw"})
                assert refused.status_code == 503
                took_s = time.monotonic() - begin
            assert took_s < 5.0 + 20 * calm.late_s
        between.holds.clear()

        async def changes():
            return (
                await client.patch("/api/v1/streams/car-7/roof/settings?prepare=true", json={"codec": "raw"})
            ).status_code == 202

        assert await until(changes, 40.0)


def test_a_store_that_is_slow_holds_up_only_the_one_who_asks(tmp_path, monkeypatch):
    store = Store(f"sqlite:///{tmp_path / 'server.db'}")
    store.open()
    token = create_token(store, "ada", "viewer")
    book = TokenBook(store)
    assert book.needed
    goes_on, asked, tokens = threading.Event(), threading.Event(), store.tokens

    def slow():
        asked.set()
        goes_on.wait(90.0)
        return tokens()

    monkeypatch.setattr(store, "tokens", slow)
    book._due = 0.0
    one = threading.Thread(target=book.client, args=(token,))
    one.start()
    assert asked.wait(60.0)
    found: list[Client] = []
    other = threading.Thread(target=lambda: found.append(book.client(token)), daemon=True)
    other.start()
    other.join(60.0)
    meanwhile = list(found)
    goes_on.set()
    one.join(60.0)
    store.close()
    assert [client.name for client in meanwhile] == ["ada"]

"""Tokens: made once, shown once, stored as SHA-256.

A token is 256 random bits, which cannot be guessed. So a slow hash, as for passwords, is not needed and would slow down
every request. A stored digest cannot be used as a token.

>>> token = new_token()
>>> token.startswith("lct_"), len(token), len(digest_of(token))
(True, 47, 64)
"""

from __future__ import annotations

import hmac
import logging
import secrets
import threading
import time
from hashlib import sha256
from typing import NamedTuple, cast

from lidarcodec.errors import SettingsError
from lidarcodec.settings import valid_name
from lidarcodec_server.config import Role
from lidarcodec_server.migrations import StoreError
from lidarcodec_server.store.store import Store, Token

logger = logging.getLogger(__name__)

PREFIX = "lct_"
REFRESH_S = 0.4
"""Interval of reading the tokens from the store: a token that another program made or revoked is known after it."""

OPENER = "serve --open"
"""Name in the audit log for `serve --open`."""

FAILED_S = 5.0
"""Wait before the store is asked again after it did not answer."""


class Client(NamedTuple):
    """A client: the name of its token, or its host if no token is needed."""

    name: str
    role: Role


def new_token() -> str:
    """256 random bits as text that headers and WebSocket subprotocols allow."""
    return PREFIX + secrets.token_urlsafe(32)


def digest_of(token: str) -> str:
    """The SHA-256 that is stored for a token."""
    return sha256(token.encode("utf-8", "surrogateescape")).hexdigest()


def create_token(store: Store, name: str, role: str, who: str = "") -> str:
    """Make a token, store its digest, and return it. It cannot be shown again. who: its maker, for the audit log

    Raises SettingsError for a name that is invalid or was used before, or an unknown role.
    """
    valid_name(name, "name")
    if role not in ("viewer", "operator"):
        raise SettingsError(f"a role must be viewer or operator, not '{role}'", "role")
    if name == "server":
        raise SettingsError(
            "the name 'server' is reserved for the server itself in the audit log: choose another", "name"
        )
    token = new_token()
    store.add_token(name, role, digest_of(token), who)
    return token


class TokenBook:
    """The valid tokens, at most half a second old. Thread-safe.

    Once a token was needed, a token is always needed, even if all tokens, or the whole database, are deleted. While the
    store does not answer, known tokens stay valid.
    """

    def __init__(self, store: Store, *, opened: bool = False) -> None:
        """opened: allow access without a token until the next token is made, although tokens were needed (`serve
        --open`)
        """
        self._store, self._opened = store, opened
        self._lock = threading.Lock()
        self._tokens: list[Token] = []
        self._past: frozenset[str] = frozenset()
        self._due = float("-inf")
        self._loaded = self._failing = self._needed = False

    @property
    def needed(self) -> bool:
        """Whether a token was ever needed. Revoking or deleting tokens does not change it."""
        self._known()
        return self._needed

    @property
    def seen(self) -> bool:
        """The same without reading the store: the last known state. It never blocks."""
        return self._needed

    @property
    def working(self) -> bool:
        """Whether there is a valid token."""
        return any(token.revoked_ns is None for token in self._known())

    def client(self, token: str) -> Client | None:
        """The client of a token; None if the token is invalid."""
        return self._client(self._known(), token)

    def seen_client(self, token: str) -> Client | None:
        """The same without reading the store: the last known state. It never blocks."""
        return self._client(self._tokens, token)

    def owner(self, token: str) -> str | None:
        """The name of a valid token, without reading the store."""
        client = self.seen_client(token)
        return None if client is None else client.name

    @staticmethod
    def _client(tokens: list[Token], token: str) -> Client | None:
        digest = digest_of(token)
        found = None
        for known in tokens:  # compare with all tokens, so that the time reveals nothing
            if hmac.compare_digest(known.digest, digest) and known.revoked_ns is None:
                found = Client(known.name, cast(Role, known.role))
        return found

    def _known(self) -> list[Token]:
        if self._lock.acquire(blocking=not self._loaded):  # one thread reads a slow store; the others do not wait
            try:
                if time.monotonic() >= self._due:
                    self._refresh()
            finally:
                self._lock.release()
        return self._tokens

    def _refresh(self) -> None:
        try:
            found = self._store.tokens()
            if not self._loaded and self._opened:
                self._open(found)
            needed = self._needed
            self._latch(found)
            if self._needed and not needed and not found:  # the first token may have been made in between
                self._latch(self._store.tokens())
            self._loaded, self._failing, wait_s = True, False, REFRESH_S
        except StoreError as error:
            if not self._loaded:
                raise
            if not self._failing:
                logger.warning("cannot read the tokens (%s): the ones that were read before stay valid", error)
            self._failing, wait_s = True, FAILED_S
        self._due = time.monotonic() + wait_s

    def _open(self, found: list[Token]) -> None:
        if any(token.revoked_ns is None for token in found):
            raise SettingsError(
                "--open allows access without a token, but there are valid tokens: revoke them first", "open"
            )
        self._past = frozenset(token.digest for token in found)
        self._store.forget_needed(OPENER)

    def _latch(self, found: list[Token]) -> None:
        if self._tokens and not found:
            logger.error(
                "the database no longer has any token: nobody has access until you create one or restore the database"
            )
        self._tokens = found
        if any(token.digest not in self._past for token in found):
            if not self._needed and not self._store.tokens_needed():
                self._store.need_tokens()
            self._needed = True
        elif not self._needed:
            self._needed = self._store.tokens_needed()

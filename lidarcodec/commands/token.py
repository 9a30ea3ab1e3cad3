"""`lidarcodec token`: manages the permissions to view and change the streams of a server."""

from __future__ import annotations

import contextlib
import getpass
import json
import os
import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any

import typer
from typer import Option

from lidarcodec.commands.results.fleet import TokenAbout, TokenCreated, TokenRevoked
from lidarcodec.commands.running.telling import prints, tell
from lidarcodec.commands.server_extra import server_config, server_module
from lidarcodec.commands.signatures.common import AsJson, DatabasePassword
from lidarcodec.errors import SettingsError, SourceError

app = typer.Typer(help="Create, list and revoke the tokens of a server.", no_args_is_help=True, rich_markup_mode=None)

Database = Annotated[
    str | None,
    Option("--database-url", metavar="URL", help="Database of the server. Default: the same as for `serve`."),
]
Name = Annotated[str, typer.Argument(metavar="NAME", show_default=False)]


@app.command()
@prints(TokenCreated)
def create(
    name: Name,
    role: Annotated[
        str, Option("--role", metavar="viewer|operator", help="Viewers can watch. Operators can also change settings.")
    ] = "viewer",
    database_url: Database = None,
    database_password_file: DatabasePassword = None,
    as_json: AsJson = False,
) -> None:
    """Create a token and print it. It is shown only once. From the first token on, every request needs a token."""
    store = _store(database_url, database_password_file, create=True)
    try:
        token = server_module("tokens").create_token(store, name, role, _who())
        created: TokenCreated = {"name": name, "role": role, "token": token}
        unprinted = _print(json.dumps(created, indent=2) if as_json else token)
        if unprinted is not None:  # no user has it, so it must not stay valid
            store.revoke_token(name, _who())
            raise SourceError(
                f"the token could not be printed ({unprinted}), so it was revoked: try again with another name"
            )
    finally:
        store.close()
    if sys.stderr.isatty() and not as_json:
        sys.stderr.write("This token is shown only once: the server keeps only its digest.\n")


@app.command("list")
@prints(list[TokenAbout])
def show(
    database_url: Database = None,
    database_password_file: DatabasePassword = None,
    as_json: AsJson = False,
) -> None:
    """List the names and roles of all tokens. The tokens themselves are not shown."""
    store = _store(database_url, database_password_file)
    try:
        known = [_about(token) for token in store.tokens()]
    finally:
        store.close()
    lines = [
        f"{token['name']:24} {token['role']:10} "
        + (f"revoked {token['revoked']}" if token["revoked"] else f"since {token['created']}")
        for token in known
    ]
    if as_json or lines:
        tell(known, "\n".join(lines), as_json)


@app.command()
@prints(TokenRevoked)
def revoke(
    name: Name,
    database_url: Database = None,
    database_password_file: DatabasePassword = None,
    as_json: AsJson = False,
) -> None:
    """Revoke a token. It stops working within a second. Its name stays in the audit log and cannot be used again."""
    store = _store(database_url, database_password_file)
    try:
        if not store.revoke_token(name, _who()):
            raise SettingsError(f"there is no valid token '{name}'", "name")
    finally:
        store.close()
    tell({"name": name}, f"{name}: revoked", as_json)


def _print(text: str) -> str | None:
    """Print a text with a token at once. Returns the reason if that fails, None otherwise."""
    if sys.stdout is None:  # the caller closed it (`>&-`)
        return "standard output is closed"
    try:
        print(text, flush=True)
    except OSError as error:
        with contextlib.suppress(OSError):  # otherwise the interpreter tries again at exit
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return error.strerror or str(error)
    return None


def _store(url: str | None, password: Path | None, *, create: bool = False) -> Any:
    config = server_config(database_url=url, database_password_file=password)
    store = server_module("store.store").Store(config.database_url)
    store.open(create=create)
    return store


def _who() -> str:
    """The user of this command, for the audit log."""
    try:
        return f"{getpass.getuser()} (command line)"
    except (KeyError, OSError, ImportError):  # a user without a name
        return "command line"


def _about(token: Any) -> TokenAbout:
    return {
        "name": token.name,
        "role": token.role,
        "created": _date(token.created_ns),
        "revoked": None if token.revoked_ns is None else _date(token.revoked_ns),
    }


def _date(stamp_ns: int) -> str:
    return datetime.fromtimestamp(stamp_ns // 10**9, UTC).isoformat()

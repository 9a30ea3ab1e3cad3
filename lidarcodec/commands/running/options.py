"""The command line. Every option is also an environment variable.

`serve --port` is LIDARCODEC_SERVE_PORT and `token create --role` is LIDARCODEC_TOKEN_CREATE_ROLE. If an option means
the same in all commands, the name of its variable has no command in it.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import Any, Final

import typer
from typer.main import get_command, get_command_name

COMMON: Final = ("CONNECT", "LISTEN", "ZENOH_CONFIG", "DATABASE_URL")
"""Options with a variable without the name of a command."""


def variable(words: Sequence[str], name: str) -> str:
    """The name of an option's environment variable.

    >>> variable(["token", "create"], "--role"), variable(["serve"], "--database-url")
    ('LIDARCODEC_TOKEN_CREATE_ROLE', 'LIDARCODEC_DATABASE_URL')
    """
    parts = [name.lstrip("-")] if _upper(name) in COMMON else [*words, name.lstrip("-")]
    return "_".join(["LIDARCODEC", *map(_upper, parts)])


def command_line(app: typer.Typer, words: Sequence[str] = ()) -> Any:
    """The command line of an app, with an environment variable for each option.

    words: the arguments. If they begin with the name of a command, only this command is built, which halves the time
    until it runs.
    """
    command = get_command(_only(app, words[0]) if words else app)
    _name(command, ())
    return command


def _only(app: typer.Typer, name: str) -> typer.Typer:
    """The app with only this command; the whole app if it has no such command."""
    one = copy.copy(app)
    one.registered_commands = [each for each in app.registered_commands if _command_name(each) == name]
    one.registered_groups = [each for each in app.registered_groups if each.name == name]
    return one if one.registered_commands or one.registered_groups else app


def _command_name(command: Any) -> str:
    return command.name or get_command_name(command.callback.__name__)


def _name(command: Any, words: tuple[str, ...]) -> None:
    for word, inner in getattr(command, "commands", {}).items():
        _name(inner, (*words, word))
    for one in command.params if words else ():
        if one.param_type_name == "option":
            one.envvar = variable(words, next(name for name in one.opts if name.startswith("--")))


def _upper(word: str) -> str:
    return word.lstrip("-").replace("-", "_").upper()

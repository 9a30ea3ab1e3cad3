"""The command line. Every option is also an environment variable.

`serve --port` is LIDARCODEC_SERVE_PORT and `token create --role` is LIDARCODEC_TOKEN_CREATE_ROLE. If an option means
the same in all commands, the name of its variable has no command in it.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator, Sequence
from typing import Any, Final, NamedTuple

import typer
from typer.main import get_command, get_command_name

COMMON: Final = ("CONNECT", "LISTEN", "ZENOH_CONFIG", "DATABASE_URL")
"""Options with a variable without the name of a command."""


FURTHER_VARIABLES: Final = {
    "LIDARCODEC_DATA": "folder of captures, for tests and for `sim:` drives that need one",
    "LIDARCODEC_DEBUG": "1: show the traceback of an error, as `--debug` does",
    "LIDARCODEC_GATE": "off: no gate in front of TLS ports",
    "LIDARCODEC_ISOLATE": "which codecs run in a process of their own: `always`, `never` or `auto`",
    "LIDARCODEC_LOOPBACK_PORT": "port at which processes of this machine meet, instead of 7447",
    "LIDARCODEC_WEIGHTS_DIR": "folder with your own weights of `riddle`, for all commands and the library",
}
"""Variables that are no option of one command, and what they mean."""


class Read(NamedTuple):
    """An option that a variable sets. words: of its command"""

    words: tuple[str, ...]
    option: str
    help: str


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
    until it runs; if with --version, none.
    """
    command = get_command(_only(app, words[0]) if words else app)
    _name(command, ())
    return command


def leaves(command: Any, words: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    """All commands that do something, with their words: `token create`, not `token`."""
    inner = getattr(command, "commands", None)
    if inner is None:
        yield words, command
        return
    for word, one in inner.items():
        yield from leaves(one, (*words, word))


def variables_of(app: typer.Typer) -> dict[str, list[Read]]:
    """Every variable, and the options that it sets."""
    found: dict[str, list[Read]] = {}
    for words, command in leaves(command_line(app)):
        for one in command.params:
            if one.param_type_name == "option" and one.envvar:
                option = next(name for name in one.opts if name.startswith("--"))
                found.setdefault(one.envvar, []).append(Read(words, option, one.help or ""))
    return found


def known_variables(app: typer.Typer) -> frozenset[str]:
    """Names of all variables that mean something."""
    return frozenset({*variables_of(app), *FURTHER_VARIABLES})


def _only(app: typer.Typer, name: str) -> typer.Typer:
    """The app with only this command, with none for --version; the whole app if it has no such command."""
    one = copy.copy(app)
    one.registered_commands = [each for each in app.registered_commands if _command_name(each) == name]
    one.registered_groups = [each for each in app.registered_groups if each.name == name]
    return one if one.registered_commands or one.registered_groups or name == "--version" else app


def _command_name(command: Any) -> str:
    return command.name or get_command_name(command.callback.__name__)


def _name(command: Any, words: tuple[str, ...]) -> None:
    for word, inner in getattr(command, "commands", {}).items():
        inner.short_help = _first_sentence(inner.help or "")
        _name(inner, (*words, word))
    for one in command.params if words else ():
        if one.param_type_name == "option":
            one.envvar = variable(words, next(name for name in one.opts if name.startswith("--")))
            one.show_envvar = False  # docs/environment.md lists all of them


def _first_sentence(text: str) -> str:
    """The first sentence of a command's help. The list of commands shows it whole.

    >>> _first_sentence("Join parts (.mcap or .pcap). Packets do not\\n change.")
    'Join parts (.mcap or .pcap).'
    """
    words = " ".join(text.split())
    end = words.find(". ")
    return words if end < 0 else words[: end + 1]


def _upper(word: str) -> str:
    return word.lstrip("-").replace("-", "_").upper()

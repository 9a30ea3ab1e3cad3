"""Tables of the command line for the documents: exit codes, variables, and fields of JSON."""

from __future__ import annotations

import json
from typing import Any, Final, Literal, NotRequired, get_args, get_origin, get_type_hints

from typing_extensions import is_typeddict

from lidarcodec.cli import app
from lidarcodec.commands.running.ending import EXIT_CODES
from lidarcodec.commands.running.options import FURTHER_VARIABLES, command_line, leaves, variables_of
from lidarcodec.commands.running.telling import schema_of

JSON_NAMES: Final = {
    int: "number",
    float: "number",
    str: "text",
    bool: "true or false",
    type(None): "null",
    Any: "value",
}


def exit_codes() -> str:
    """Exit codes of the command line."""
    rows = [f"| {code} | {text} |" for code, text in EXIT_CODES]
    return "\n".join(["| code | meaning |", "|---|---|", *rows])


def variables() -> str:
    """Every option of every command, with its environment variable."""
    rows = ["| variable | option | |", "|---|---|---|"]
    for name, read in sorted(variables_of(app).items()):
        where = (
            f"`{' '.join(read[0].words)} {read[0].option}`"
            if len(read) == 1
            else f"`{read[0].option}` of every command"
        )
        rows.append(f"| `{name}` | {where} | {_cell(read[0].help)} |")
    return "\n".join(rows)


def further_variables() -> str:
    """Variables that are no option of one command."""
    rows = [f"| `{name}` | {text} |" for name, text in FURTHER_VARIABLES.items()]
    return "\n".join(["| variable | |", "|---|---|", *rows])


def json_of_commands() -> str:
    """Fields of what each command prints with `--json`."""
    parts, shown = [], {}
    for words, command in leaves(command_line(app)):
        schema = schema_of(command.callback)
        if schema is None:
            continue
        name, types = " ".join(words), members(schema)
        many = get_origin(schema) is list
        parts.append(f"## {name}\n")
        if types[0] in shown:
            parts.append(f"As of [{shown[types[0]]}](#{shown[types[0]].replace(' ', '-')}).\n")
            continue
        for kind in types:
            shown[kind] = name
            about = " ".join((kind.__doc__ or "").split())
            parts += [("A list of objects. " if many and kind is types[0] else "") + about + "\n", fields(kind), ""]
    return "\n".join(parts).rstrip()


def members(schema: Any) -> list[Any]:
    """The types of objects in a schema: one, those of a union, or those of a list."""
    inner = get_args(schema)[0] if get_origin(schema) is list else schema
    return [inner] if is_typeddict(inner) else list(get_args(inner))


def fields(kind: Any) -> str:
    """The fields of a TypedDict as a table."""
    rows = ["| field | type | |", "|---|---|---|"]
    for name, whole in get_type_hints(kind, include_extras=True).items():
        optional = get_origin(whole) is NotRequired
        hint, about = get_args(get_args(whole)[0] if optional else whole)[:2]
        also = " (left out where it does not apply)" if optional else ""
        rows.append(f"| `{name}` | {_cell(type_text(hint))} | {_cell(about)}{also} |")
    return "\n".join(rows)


def type_text(kind: Any) -> str:
    """A type in JSON's words."""
    origin, inner = get_origin(kind), get_args(kind)
    if kind in JSON_NAMES:
        return JSON_NAMES[kind]
    if is_typeddict(kind):
        return "object"
    if origin is Literal:
        return " or ".join(f"`{json.dumps(one)}`" for one in inner)
    if origin is list:
        text = type_text(inner[0])
        return f"list of {text if text.endswith('s') else text + 's'}" if inner[0] is not Any else "list"
    if origin is dict:
        return "object" if inner[1] is Any else f"object of {type_text(inner[1])}s"
    return " or ".join(dict.fromkeys(map(type_text, inner)))


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")

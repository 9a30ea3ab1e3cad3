"""`lidarcodec info`: describes a source, a recording, or one message."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from lidarcodec.commands.running.telling import tell
from lidarcodec.errors import SettingsError
from lidarcodec.sensors.models.table import aside_name
from lidarcodec.sources.spec import parse
from lidarcodec.sources.table import SCHEMES, kind_of
from lidarcodec.untrusted.text import printable

KEY_WIDTH = 24
POSITIONS = "position packets"
SHORT_TURNS, SHOWN_ROWS = "short_turns", 20
"""A table that can be long, and how many of its rows the text has; JSON has all."""


def run(source: str, message: int | None, calibration: Path | None, as_json: bool) -> None:
    """Collect the information and print it."""
    found = _of_source(source, message, calibration)
    aside = f"{aside_name(found.get('model', ''))}s"
    shown = {aside if name == POSITIONS else name: value for name, value in found.items()}
    tell(found, "\n".join(lines_of(shown)), as_json)


def _of_source(source: str, message: int | None, calibration: Path | None) -> dict[str, Any]:
    spec = parse(source, SCHEMES)
    recording = kind_of(spec) == "recording"
    if message is not None and not recording:
        raise SettingsError(f"{source} is not a recording: it has no messages", "message")
    if message is not None and spec.options:
        raise SettingsError(f"--message counts all messages of {spec.path}: leave out the part after the ?", "message")
    if recording and not spec.options:
        from lidarcodec.commands.info.recording import explain_message, inspect_recording

        return inspect_recording(spec.path) if message is None else explain_message(spec.path, message)
    # With `?read=` or `?topic=` a recording is read as a source of packets, as in all commands that take a source.
    from lidarcodec.commands.info.source import inspect_source

    return inspect_source(source, calibration)


def lines_of(values: dict[str, Any], indent: str = "") -> list[str]:
    """Lines of a key and a value. Mappings and tables are indented below their key."""
    lines = []
    for key, value in values.items():
        name = indent + printable(key)
        if isinstance(value, dict) and value.keys() == {"origin", "hash"}:
            origin = printable(f"{value['origin']} {value['hash']}")
            lines.append(f"{name:<{KEY_WIDTH}} {origin}")
        elif isinstance(value, dict) and value:
            lines += [name, *lines_of(value, indent + "  ")]
        elif isinstance(value, list) and value:
            lines += [
                name,
                *(f"{indent}  {row}" for row in _table(value, SHOWN_ROWS if key == SHORT_TURNS else len(value))),
            ]
        elif value not in (None, {}, []):
            lines.append(f"{name:<{KEY_WIDTH}} {printable(str(value))}")
    return lines


def _table(rows: list[dict[str, Any]], most: int) -> list[str]:
    names = list(rows[0])
    cells = [names, *([printable(str(row[name])) for name in names] for row in rows[:most])]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in cells]
    return lines + [f"and {len(rows) - most} more: --json has all"] * (len(rows) > most)

"""Checks of a source before a command reads it."""

from __future__ import annotations

from pathlib import Path

from lidarcodec.errors import SettingsError, UnknownNameError
from lidarcodec.sources.drive import SCENES
from lidarcodec.sources.spec import LIVE, parse


def is_endless(spec: str) -> bool:
    """Whether this source has no end: a socket, or a simulated drive without a length."""
    parsed = parse(spec)
    return parsed.scheme in LIVE or (parsed.scheme == "sim" and "frames" not in parsed.options)


def check_finite(spec: str, frames: int | None, live_too: bool = True) -> None:
    """Raise SettingsError if this source has no end. Live sources are checked only with `live_too`."""
    parsed = parse(spec)
    if parsed.scheme == "sim" and parsed.place and parsed.place not in SCENES:
        raise UnknownNameError("simulated scene", parsed.place, SCENES)
    if frames is None and is_endless(spec) and (live_too or parse(spec).scheme not in LIVE):
        raise SettingsError(f"{spec} has no end: set its length with --frames N", "frames")


def check_recorded(spec: str) -> None:
    """Raise SettingsError if this source is live, because its packets cannot be read again."""
    if parse(spec).scheme in LIVE:
        raise SettingsError(
            f"{spec} is live and cannot be read again: give the capture from which the recording was made"
        )


def check_not_input(out: Path, spec: str | Path) -> None:
    """Raise SettingsError if writing `out` would overwrite the source: opening a file for writing empties it."""
    path = spec if isinstance(spec, Path) else parse(spec).path
    if not (out.exists() and path.exists()):
        return
    ours, read = out.resolve(), path.resolve()
    if out.samefile(path) or ours in read.parents or read in ours.parents:
        raise SettingsError(f"{out} is the input, or a part of it: give the output another name")


def identity(spec: str) -> str:
    """A text that is equal for equal sources, for any spelling of the path and any order of the options."""
    parsed = parse(spec)
    place = parsed.path.resolve() if parsed.path.exists() else parsed.place
    return f"{parsed.scheme}:{place}?{sorted(parsed.options.items())}"


def readable(name: str | Path) -> str:
    """A name as valid Unicode, so that it can be stored: invalid bytes of a file name become escapes."""
    return str(name).encode("utf-8", "backslashreplace").decode()

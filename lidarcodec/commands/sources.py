"""What the commands ask of a source before they read it."""

from __future__ import annotations

from pathlib import Path

from lidarcodec.errors import SettingsError
from lidarcodec.sources.spec import parse


def is_endless(spec: str) -> bool:
    """Whether reading this source would never end: a socket, or a simulated drive without a length."""
    parsed = parse(spec)
    return parsed.scheme == "udp" or (parsed.scheme == "sim" and "frames" not in parsed.options)


def check_finite(spec: str, frames: int | None, live_too: bool = True) -> None:
    """Raise SettingsError if reading this source would never end; a live one counts when `live_too`."""
    if frames is None and is_endless(spec) and (live_too or parse(spec).scheme != "udp"):
        raise SettingsError(f"{spec} has no end: set its length with --frames N", "frames")


def check_recorded(spec: str) -> None:
    """Raise SettingsError if this source is live: what it gave once it never gives again."""
    if parse(spec).scheme == "udp":
        raise SettingsError(
            f"{spec} is live and cannot be read again: give the capture from which the recording was made"
        )


def check_not_input(out: Path, spec: str | Path) -> None:
    """Raise SettingsError if writing `out` would destroy what is read: opening it for writing empties it."""
    path = spec if isinstance(spec, Path) else parse(spec).path
    if not (out.exists() and path.exists()):
        return
    ours, read = out.resolve(), path.resolve()
    if out.samefile(path) or ours in read.parents or read in ours.parents:
        raise SettingsError(f"{out} is the input, or a part of it: give the output another name")


def identity(spec: str) -> str:
    """The same for what is the same source, however its path and the order of its options are written."""
    parsed = parse(spec)
    place = parsed.path.resolve() if parsed.path.exists() else parsed.place
    return f"{parsed.scheme}:{place}?{sorted(parsed.options.items())}"


def readable(name: str | Path) -> str:
    """A name as valid Unicode: bytes of a file name that are none become escapes, so that it can be stored."""
    return str(name).encode("utf-8", "backslashreplace").decode()

"""What the commands ask of a source before they read it."""

from __future__ import annotations

from lidarcodec.errors import SettingsError
from lidarcodec.sources.spec import parse


def is_endless(spec: str) -> bool:
    """Whether reading this source would never end: a socket, or a simulated drive without a length."""
    parsed = parse(spec)
    return parsed.scheme == "udp" or (parsed.scheme == "sim" and "frames" not in parsed.options)


def check_finite(spec: str, frames: int | None, live_too: bool = True) -> None:
    """Raise SettingsError if reading this source would never end; a live one counts when `live_too`."""
    if frames is None and is_endless(spec) and (live_too or parse(spec).scheme != "udp"):
        raise SettingsError(f"{spec} has no end: say how much of it with --frames N", "frames")

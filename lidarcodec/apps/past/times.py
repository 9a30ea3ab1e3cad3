"""The span of a clip, and its quality, as people and programs ask for them."""

from __future__ import annotations

from typing import Final

from lidarcodec.errors import SettingsError
from lidarcodec.untrusted.times import time_ns_of

MAX_AHEAD_NS: Final = 600 * 10**9


def span_of(begin: object, end: object, *, now_ns: int) -> tuple[int, int]:
    """Begin and end of a clip in ns since the Unix epoch.

    Raises SettingsError for times that cannot be read, and for an end that is more than ten minutes ahead.
    """
    from_ns, to_ns = time_ns_of(begin, "from"), time_ns_of(end, "to")
    if to_ns > now_ns + MAX_AHEAD_NS:
        raise SettingsError("a clip may end at most ten minutes after now", "to")
    return from_ns, to_ns


def check_quality(quality: str) -> None:
    """Raises SettingsError for anything but `exact`: vehicles keep exact packets only."""
    if quality == "base":
        raise SettingsError("vehicles keep exact packets only: ask with quality=exact", "quality")
    if quality != "exact":
        raise SettingsError("quality must be exact", "quality")

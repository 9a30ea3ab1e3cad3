"""Which commands a signal ends as it should: those that have no end of their own. All others were interrupted then."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

DONE, FAILED, WRONG_USAGE = 0, 1, 2
INTERRUPTED: Final = 128
"""The exit code of an interrupted command is this and the number of the signal, as shells count: 130 or 143."""
LIVE: Final = frozenset({"publish", "subscribe", "serve", "demo", "bridge", "swarm"})


def is_live(words: Sequence[str]) -> bool:
    """Whether these words of a command line name a command that runs until a signal comes.

    >>> is_live(["--debug", "publish", "sim:city"]), is_live(["encode", "publish", "out.mcap"])
    (True, False)
    """
    return next((word for word in words if not word.startswith("-")), "") in LIVE

"""Which commands run until a signal. For them a signal is the normal end; it interrupts all other commands."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

DONE, FAILED, WRONG_USAGE = 0, 1, 2
INTERRUPTED: Final = 128
"""The exit code of an interrupted command is this plus the number of the signal, as in shells: 130 or 143."""
LIVE: Final = frozenset({"publish", "subscribe", "serve", "demo", "bridge", "swarm"})


def is_live(words: Sequence[str]) -> bool:
    """Whether these words of a command line name a command that runs until a signal.

    >>> is_live(["--debug", "publish", "sim:city"]), is_live(["encode", "publish", "out.mcap"])
    (True, False)
    """
    return next((word for word in words if not word.startswith("-")), "") in LIVE

"""Which commands run until a signal. For them a signal is the normal end; it interrupts all other commands."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

DONE, FAILED, WRONG_USAGE = 0, 1, 2
INTERRUPTED: Final = 128
"""The exit code of an interrupted command is this plus the number of the signal, as in shells: 130 or 143."""
LIVE_IN_ORDER: Final = ("publish", "subscribe", "localise", "serve", "demo", "bridge", "swarm", "pipe")
LIVE: Final = frozenset(LIVE_IN_ORDER)


EXIT_CODES: Final[tuple[tuple[str, str], ...]] = (
    (
        "0",
        "everything was done. `decode` of a damaged recording also ends with 0, and a warning, if it found any frame",
    ),
    ("0", f"a signal ended a command that has no end of its own: {', '.join(f'`{name}`' for name in LIVE_IN_ORDER)}"),
    ("1", "the command failed"),
    ("1", "`verify`: a promise is broken, or the recording covers less than its source"),
    ("1", "`health` and `doctor`: something does not work"),
    (
        "1",
        "`encode` and `convert`: a target bitrate was missed, or kept only by leaving out frames because of settings "
        "that you gave, without `--allow-missed`",
    ),
    (
        "1",
        "`publish` and `subscribe`, however they ended: a recording (`--record`) stopped before the stream did, the "
        "disk was too slow for it, or a file of it was removed, replaced or written over",
    ),
    (
        "1",
        "standard output could not be written, on a full disk for example. The printed text is lost, as with `cp` and "
        "`tee`, and the error says so. Output files are whole, and `verify` has its own code",
    ),
    (
        "2",
        "wrong usage: an option, a setting or a name; also an output that exists already, or an "
        "[extra](installing.md#extras) that is not installed",
    ),
    ("130, 143", "SIGINT (Ctrl-C) or SIGTERM interrupted any other command before it was done"),
    ("129", "its terminal was closed (SIGHUP): nothing is kept then"),
)
"""All exit codes and what they mean, for docs/commands.md."""


def is_live(words: Sequence[str]) -> bool:
    """Whether these words of a command line name a command that runs until a signal.

    >>> is_live(["--debug", "publish", "sim:city"]), is_live(["encode", "publish", "out.mcap"])
    (True, False)
    """
    return next((word for word in words if not word.startswith("-")), "") in LIVE

"""Zenoh's log: from standard output to standard error, one line of each kind a minute; the others are counted.

Zenoh writes its log past Python, and a line for every connection that it refuses, so strangers could fill a disk. Where
the variable RUST_LOG is set somebody wants to see it all, and gets it as it is.
"""

from __future__ import annotations

import contextlib
import os
import re
import threading
import time
from collections.abc import Callable, Iterator
from typing import Final

from lidarcodec.bridges.viewer_log import kind_of

EVERY_S: Final = 60.0
MOST_KINDS: Final = 32
"""Strangers may choose words of a line, so there is a limit; all further kinds count as one."""
END_S: Final = 1.0
MAX_LINE: Final = 4096
_COLOURS: Final = re.compile(r"\x1b\[[0-9;]*m")
_OTHERS: Final = "other lines"


class Sparse:
    """Which lines to pass on.

    >>> clock = [0.0]
    >>> sparse = Sparse(lambda: clock[0])
    >>> sparse.passed("12:00 refused 10.0.0.1"), sparse.passed("12:01 refused 10.0.0.2")
    ('12:00 refused 10.0.0.1', None)
    >>> clock[0] = 60.0; sparse.passed("12:02 refused 10.0.0.3")
    '12:02 refused 10.0.0.3 (and 1 more of this kind)'
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._kinds: dict[str, tuple[float, int]] = {}

    def passed(self, line: str) -> str | None:
        """The line, with how many of its kind were left out before it; None if it is left out."""
        kind = kind_of(line)
        if kind not in self._kinds and len(self._kinds) >= MOST_KINDS:
            kind = _OTHERS
        now_s = self._clock()
        said_s, left_out = self._kinds.get(kind, (float("-inf"), 0))
        if now_s - said_s < EVERY_S:
            self._kinds[kind] = said_s, left_out + 1
            return None
        self._kinds[kind] = now_s, 0
        return f"{line} (and {left_out} more of this kind)" if left_out else line

    def rest(self) -> Iterator[str]:
        """What was left out and not told since, by kind."""
        for kind, (_, left_out) in self._kinds.items():
            if left_out:
                yield f"{left_out} more of this kind: {kind}"


class ZenohLog:
    """Takes standard output of this process, descriptor 1, from `begin` to `end`."""

    def __init__(self) -> None:
        self._thread: threading.Thread | None = None

    def begin(self) -> None:
        """Take what is written there from now on; Python's own `sys.stdout` has to have another descriptor by now."""
        if os.environ.get("RUST_LOG"):
            os.dup2(2, 1)
            return
        reading, writing = os.pipe()
        os.dup2(writing, 1)
        os.close(writing)
        self._thread = threading.Thread(target=_pass_on, args=(reading,), name="lidarcodec Zenoh's log", daemon=True)
        self._thread.start()

    def end(self) -> None:
        """Pass on what is left; from then on what is written there goes to standard error."""
        thread, self._thread = self._thread, None
        if thread is not None:
            os.dup2(2, 1)
            thread.join(END_S)  # processes that were started meanwhile may keep the pipe open


def _pass_on(reading: int) -> None:
    sparse = Sparse()
    with os.fdopen(reading, "rb") as lines:
        while line := lines.readline(MAX_LINE):
            _write(sparse.passed(_COLOURS.sub("", line.decode(errors="replace").rstrip("\n"))))
    for rest in sparse.rest():
        _write(rest)


def _write(line: str | None) -> None:
    if line is not None:
        with contextlib.suppress(OSError):  # nobody reads it: go on, or Zenoh would wait
            os.write(2, f"{line}\n".encode())


zenoh_log: Final = ZenohLog()
"""That of this process."""

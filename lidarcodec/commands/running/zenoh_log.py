"""Redirects Zenoh's log from standard output to standard error, one line of each kind a minute; others are counted.
Lines that nobody can act on are left out.

Zenoh writes its log without Python, with a line for every refused connection, so strangers could fill a disk. If the
variable RUST_LOG is set, the log is passed on unchanged.
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
from lidarcodec.untrusted.text import printable

EVERY_S: Final = 60.0
MOST_KINDS: Final = 32
"""Most kinds of lines. Strangers can choose words in a line, so there is a limit; all further kinds count as one."""
END_S: Final = 1.0
MAX_LINE: Final = 4096
NO_MATTER: Final = ("zenoh::api::admin: Unable to find transport for link event",)
"""Parts of lines that mean nothing here. This one is about Zenoh's own list of links, in which a session tells itself
what it is connected to: lidarcodec does not read it."""
_COLOURS: Final = re.compile(r"\x1b\[[0-9;]*m")
_OTHERS: Final = "other lines"


class Sparse:
    """Decides which lines to pass on.

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
        """The line, with the number of omitted lines of its kind; None if this line is omitted."""
        if any(one in line for one in NO_MATTER):
            return None
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
        """Counts of omitted lines that were not reported yet, by kind."""
        for kind, (_, left_out) in self._kinds.items():
            if left_out:
                yield f"{left_out} more of this kind: {kind}"


class ZenohLog:
    """Redirects standard output of this process, descriptor 1, from `begin` to `end`."""

    def __init__(self) -> None:
        self._thread: threading.Thread | None = None

    def begin(self) -> None:
        """Begin to redirect. Python's own `sys.stdout` must already have another descriptor."""
        if os.environ.get("RUST_LOG"):
            os.dup2(2, 1)
            return
        reading, writing = os.pipe()
        os.dup2(writing, 1)
        os.close(writing)
        self._thread = threading.Thread(target=_pass_on, args=(reading,), name="lidarcodec Zenoh's log", daemon=True)
        self._thread.start()

    def end(self) -> None:
        """Pass on the rest. From here on descriptor 1 is standard error."""
        thread, self._thread = self._thread, None
        if thread is not None:
            os.dup2(2, 1)
            thread.join(END_S)  # child processes may keep the pipe open


def _pass_on(reading: int) -> None:
    sparse = Sparse()
    with os.fdopen(reading, "rb") as lines:
        while line := lines.readline(MAX_LINE):
            _write(sparse.passed(_COLOURS.sub("", line.decode(errors="replace").rstrip("\n"))))
    for rest in sparse.rest():
        _write(rest)


def _write(line: str | None) -> None:
    if line is not None:
        with contextlib.suppress(OSError):  # no reader: continue, otherwise Zenoh would block
            os.write(2, f"Zenoh: {printable(line)}\n".encode())


zenoh_log: Final = ZenohLog()
"""The log of this process."""

"""Stopping between two frames: SIGINT and SIGTERM end work that writes a file without breaking what it is writing."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

SIGNALS = (signal.SIGINT, signal.SIGTERM)


@contextmanager
def stoppable(wake: Callable[[], None] | None = None) -> Iterator[Callable[[], bool]]:
    """Function that says whether a signal asked to stop. A second one interrupts at once.

    wake: called at the first signal, to end a read that waits
    """
    asked = False

    def ask(_number: int, _frame: FrameType | None) -> None:
        nonlocal asked
        if asked:
            raise KeyboardInterrupt
        asked = True
        if wake is not None:
            wake()

    before = [signal.signal(number, ask) for number in SIGNALS]
    try:
        yield lambda: asked
    finally:
        for number, handler in zip(SIGNALS, before, strict=True):
            signal.signal(number, handler)

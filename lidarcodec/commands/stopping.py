"""Stopping between two frames: SIGINT and SIGTERM end work that writes a file without breaking what it is writing."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

SIGNALS = (signal.SIGINT, signal.SIGTERM)
SAME_WISH_S = 1.0


class Interrupter:
    """The handler of a command that is still starting: it interrupts, and remembers that it did.

    The KeyboardInterrupt alone is not enough: raised while a module of native code is loaded, or something is thrown
    away, Python tells of it and goes on.
    """

    def __init__(self) -> None:
        self.asked = False

    def __call__(self, _number: int, _frame: FrameType | None) -> None:
        self.asked = True
        raise KeyboardInterrupt

    def install(self) -> None:
        """Take the signals, with nothing to remember yet."""
        self.asked = False
        for number in SIGNALS:
            signal.signal(number, self)


def stop_asked() -> bool:
    """Whether a signal asked a command that is still starting to end. For what takes signals in its own way then."""
    return any(isinstance(handler, Interrupter) and handler.asked for handler in map(signal.getsignal, SIGNALS))


@contextmanager
def stoppable(wake: Callable[[], None] | None = None) -> Iterator[Callable[[], bool]]:
    """Function that says whether a signal asked to stop. A second one, a second later or more, interrupts at once.

    One wish to stop often comes as two signals: `timeout` sends its own to the process and to the group, and whoever
    started us from a terminal passes on the one that we had already. They must not cut a file that is being ended.

    wake: called at the first signal, to end a read that waits
    """
    asked_s: float | None = None

    def ask(_number: int, _frame: FrameType | None) -> None:
        nonlocal asked_s
        if asked_s is not None:
            if time.monotonic() - asked_s >= SAME_WISH_S:
                raise KeyboardInterrupt
            return
        asked_s = time.monotonic()
        if wake is not None:
            wake()

    already = stop_asked()
    before = [signal.signal(number, ask) for number in SIGNALS]
    if already:
        ask(signal.SIGTERM, None)
    try:
        yield lambda: asked_s is not None
    finally:
        for number, handler in zip(SIGNALS, before, strict=True):
            signal.signal(number, handler)

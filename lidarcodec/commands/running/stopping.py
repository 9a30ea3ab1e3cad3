"""Stopping between two frames: SIGINT and SIGTERM end work that writes a file without breaking what it is writing."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Generic, TypeVar

SIGNALS = (signal.SIGINT, signal.SIGTERM)
SAME_WISH_S = 1.0
Item = TypeVar("Item")


class StoppedError(Exception):
    """A signal ended work before it was done; says what was kept, and how to do the rest."""


def interrupted_after(done: int, wanted: int) -> dict[str, bool | int]:
    """What stands behind the results of a command that a signal ended, in its JSON."""
    return {"complete": False, "interrupted": True, "done": done, "wanted": wanted}


class _Came:
    """The first signal of this command."""

    number: int | None = None


def signal_that_came() -> int | None:
    """The first signal that asked this command to end; None if there was none."""
    return _Came.number


def _note(number: int) -> None:
    if _Came.number is None:
        _Came.number = number


class Interrupter:
    """The handler of a command that is still starting: it interrupts, and remembers that it did.

    The KeyboardInterrupt alone is not enough: raised while a module of native code is loaded, or something is thrown
    away, Python tells of it and goes on.
    """

    def __init__(self) -> None:
        self.asked = False

    def __call__(self, number: int, _frame: FrameType | None) -> None:
        self.asked = True
        _note(number)
        raise KeyboardInterrupt

    def install(self, *, hangup: bool = False) -> None:
        """Take the signals, with nothing to remember yet.

        hangup: also SIGHUP, of a terminal that is closed, unless it is ignored, as `nohup` has it
        """
        self.asked = False
        _Came.number = None
        for number in SIGNALS:
            signal.signal(number, self)
        if hangup and signal.getsignal(signal.SIGHUP) == signal.SIG_DFL:
            signal.signal(signal.SIGHUP, self)


def stop_asked() -> bool:
    """Whether a signal asked a command that is still starting to end. For what takes signals in its own way then."""
    return any(isinstance(handler, Interrupter) and handler.asked for handler in map(signal.getsignal, SIGNALS))


def ignore_signals() -> None:
    """Nothing is left to be stopped: the command is ending."""
    for number in (*SIGNALS, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)


@contextmanager
def stoppable(wake: Callable[[], None] | None = None) -> Iterator[Callable[[], bool]]:
    """Function that says whether a signal asked to stop. A second one, a second later or more, interrupts at once.

    Often two signals mean one wish to stop: `timeout` signals both the process and its group, and a parent process on a
    terminal passes on a signal that we had already. The second one must not cut off a file that is being finished.

    wake: called at the first signal, to end a read that waits
    """
    asked_s: float | None = None

    def ask(number: int, _frame: FrameType | None) -> None:
        nonlocal asked_s
        _note(number)
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
        ask(_Came.number or signal.SIGTERM, None)
    try:
        yield lambda: asked_s is not None
    finally:
        for number, handler in zip(SIGNALS, before, strict=True):
            signal.signal(number, handler)


class Watched(Generic[Item]):
    """Items until a signal asks to stop. cut: whether there were more of them."""

    def __init__(self, items: Iterable[Item], stopped: Callable[[], bool]) -> None:
        self._items, self._stopped = items, stopped
        self.cut = False

    def __iter__(self) -> Iterator[Item]:
        for item in self._items:
            if self._stopped():
                self.cut = True
                return
            yield item

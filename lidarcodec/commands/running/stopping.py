"""Stops work between two frames: after SIGINT or SIGTERM the file that is being written stays readable."""

from __future__ import annotations

import _thread
import signal
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Generic, TypeVar

SIGNALS = (signal.SIGINT, signal.SIGTERM)
SAME_WISH_S = 1.0
WAKE_S = 5.0
Item = TypeVar("Item")


class StoppedError(Exception):
    """A signal ended the work early. The text says what was kept and how to get the rest."""


def interrupted_after(done: int, wanted: int) -> dict[str, bool | int]:
    """The last entry in the JSON output of a command that a signal ended."""
    return {"complete": False, "interrupted": True, "done": done, "wanted": wanted}


class _Came:
    """Holds the first signal of this command."""

    number: int | None = None


def signal_that_came() -> int | None:
    """The first signal to this command; None if there was none."""
    return _Came.number


def _note(number: int) -> None:
    if _Came.number is None:
        _Came.number = number


class Interrupter:
    """The signal handler while a command starts: it raises KeyboardInterrupt, and remembers the signal.

    KeyboardInterrupt alone is not enough: during the import of a native module or in a destructor Python only prints
    it and continues.
    """

    def __init__(self) -> None:
        self.asked = False

    def __call__(self, number: int, _frame: FrameType | None) -> None:
        self.asked = True
        _note(number)
        raise KeyboardInterrupt

    def install(self, *, hangup: bool = False) -> None:
        """Handle the signals from here on, and forget earlier ones.

        hangup: also handle SIGHUP (a closed terminal), unless it is ignored, as under `nohup`
        """
        self.asked = False
        _Came.number = None
        for number in SIGNALS:
            signal.signal(number, self)
        if hangup and signal.getsignal(signal.SIGHUP) == signal.SIG_DFL:
            signal.signal(signal.SIGHUP, self)


def stop_asked() -> bool:
    """Whether a signal arrived during the start. For commands that handle signals themselves afterwards."""
    return any(isinstance(handler, Interrupter) and handler.asked for handler in map(signal.getsignal, SIGNALS))


def ignore_signals() -> None:
    """Ignore signals from here on, because the command is ending."""
    for number in (*SIGNALS, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)


@contextmanager
def stoppable(wake: Callable[[], None] | None = None) -> Iterator[Callable[[], bool]]:
    """Gives a function that says whether a signal arrived. A second signal, at least a second later, interrupts at
    once.

    Two signals in quick succession count as one: `timeout` signals both the process and its group, and a parent process
    on a terminal passes on a signal that this process already got. The second one must not damage a file that is being
    completed.

    wake: called at the first signal, in a thread of its own, to end a blocking read. The main thread may hold the very
        lock that it needs: in `Event.wait`, for instance. It has returned, or WAKE_S have passed, when the block ends.
    """
    asked_s: float | None = None
    interrupted = over = False
    woken, main_thread = threading.Event(), threading.get_ident()  # handlers are set in no other thread

    def interrupt() -> None:
        """Interrupt the main thread by real signals until it is interrupted: one that comes just before a wait does not
        end it. `_thread.interrupt_main` only sets a flag, which a wait for a lock sees when it is over."""
        while not (interrupted or over) and signal.getsignal(signal.SIGINT) is ask:
            signal.pthread_kill(main_thread, signal.SIGINT)
            time.sleep(0.05)

    def end_the_wait() -> None:
        nonlocal asked_s
        try:
            if wake is not None:
                wake()
        except BaseException:  # nothing ends the wait now: interrupt it, as a later second signal would
            asked_s = -SAME_WISH_S
            interrupt()
            raise
        finally:
            woken.set()

    def ask(number: int, _frame: FrameType | None) -> None:
        nonlocal asked_s, interrupted
        _note(number)
        if asked_s is not None:
            if time.monotonic() - asked_s >= SAME_WISH_S:
                interrupted = True
                raise KeyboardInterrupt
            return
        asked_s = time.monotonic()
        if wake is not None:
            try:
                _thread.start_new_thread(end_the_wait, ())  # Thread.start would take a lock of `threading`
            except RuntimeError:  # no more threads
                end_the_wait()

    already = stop_asked()
    before = [signal.signal(number, ask) for number in SIGNALS]
    if already:
        ask(_Came.number or signal.SIGTERM, None)
    try:
        yield lambda: asked_s is not None
    finally:
        over = True
        for number, handler in zip(SIGNALS, before, strict=True):
            signal.signal(number, handler)
        if asked_s is not None and wake is not None:
            woken.wait(WAKE_S)


class Watched(Generic[Item]):
    """Iterates over items until a signal arrives. cut: whether items were left"""

    def __init__(self, items: Iterable[Item], stopped: Callable[[], bool]) -> None:
        self._items, self._stopped = items, stopped
        self.cut = False

    def __iter__(self) -> Iterator[Item]:
        for item in self._items:
            if self._stopped():
                self.cut = True
                return
            yield item

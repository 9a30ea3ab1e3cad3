"""A signal ends a command whenever it comes: a wish that got lost would leave a process that nobody stops."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import suppress

import pytest

from lidarcodec.commands.running.stopping import SIGNALS, Interrupter, stoppable


@pytest.fixture(autouse=True)
def _handlers() -> Iterator[None]:
    before = [signal.getsignal(number) for number in SIGNALS]
    yield
    for number, handler in zip(SIGNALS, before, strict=True):
        signal.signal(number, handler)


@pytest.mark.parametrize("number", SIGNALS)
def test_a_signal_that_was_swallowed_while_starting_still_stops(number: signal.Signals) -> None:
    woken: list[bool] = []
    Interrupter().install()
    with suppress(KeyboardInterrupt):
        os.kill(os.getpid(), number)
    with stoppable(lambda: woken.append(True)) as stopped:
        assert stopped()
    assert woken == [True]


def test_a_signal_in_the_middle_of_a_wait_does_not_hang_the_command() -> None:
    """`wake` needs the lock that the main thread holds while it begins to wait, as `Event.set` does."""
    lock, woken = threading.Lock(), threading.Event()

    def wake() -> None:
        with lock:
            woken.set()

    with stoppable(wake) as stopped:
        with lock:
            os.kill(os.getpid(), signal.SIGTERM)
            assert stopped()
        assert woken.wait(10.0)


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_a_wait_that_cannot_be_ended_is_interrupted() -> None:
    """At once: the interrupt of `_thread` only sets a flag, which a wait for a lock sees when it is over."""

    def wake() -> None:
        raise OSError("the source cannot be closed")

    def command() -> None:
        with stoppable(wake):
            os.kill(os.getpid(), signal.SIGTERM)
            threading.Event().wait(60.0)

    began_s = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        command()
    assert time.monotonic() - began_s < 30.0


def test_without_a_signal_nothing_stops_and_a_new_start_has_forgotten() -> None:
    interrupter = Interrupter()
    interrupter.install()
    with pytest.raises(KeyboardInterrupt):
        os.kill(os.getpid(), signal.SIGTERM)
    interrupter.install()
    with stoppable() as stopped:
        assert not stopped()
        os.kill(os.getpid(), signal.SIGTERM)
        assert stopped()

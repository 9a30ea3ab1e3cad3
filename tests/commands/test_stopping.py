"""A signal ends a command whenever it comes: a wish that got lost would leave a process that nobody stops."""

from __future__ import annotations

import os
import signal
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

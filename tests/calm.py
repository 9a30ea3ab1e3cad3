"""Whether the machine was calm enough for what is said about time: how late it woke a thread that only sleeps.

A machine that others use too may wake every thread a quarter of a second late; no stream is at its pace there. So what
tests say about time holds unless the machine was late itself, as measured beside it.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Self

import pytest

STEP_S = 0.005


class Calm:
    """Sleeps in small steps, in a thread of its own, while the body of a `with` runs.

    late_s: how late it was woken, at worst
    """

    def __init__(self) -> None:
        self.late_s = 0.0
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="calm", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *exc: object) -> None:
        self._stop.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._stop.is_set():
            begin = time.monotonic()
            time.sleep(STEP_S)
            self.late_s = max(self.late_s, time.monotonic() - begin - STEP_S)


def when_calm(check: Callable[[], object], late_s: float, attempts: int = 4) -> None:
    """Run a check of something in time; again when it fails on a machine that woke threads later than so much.

    On a machine that is never calm the test is skipped, and says why.
    """
    late: list[float] = []
    while len(late) < attempts:
        with Calm() as calm:
            try:
                check()
            except AssertionError:
                if calm.late_s <= late_s:
                    raise
            else:
                return
        late.append(calm.late_s)
    pytest.skip(f"this machine wakes threads up to {min(late):.2f} s late")

"""Runs long work in a thread, so that a signal ends it at once, and shows how far it is."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable
from typing import Final

from lidarcodec.errors import told

TICK_S: Final = 0.5


def attended(
    work: Callable[[], object], cancel: Callable[[], object], stop: threading.Event, line: Callable[[], str]
) -> None:
    """Do the work in a thread. Raises what it raises.

    cancel: makes it end soon, called when `stop` is set;  line: how far it is, asked often, shown on a terminal
    """
    failed: list[Exception] = []

    def run() -> None:
        try:
            work()
        except BaseException as error:  # a panic of native code is not an Exception
            failed.append(told(error))

    thread = threading.Thread(target=run, name="lidarcodec fetch", daemon=True)
    thread.start()
    show = sys.stderr.isatty()
    while thread.is_alive():
        thread.join(TICK_S)
        if stop.is_set():
            cancel()
        now = line()
        if show:
            sys.stderr.write(f"\r{now}\x1b[K")
    if show:
        sys.stderr.write("\r\x1b[K")
    if failed:
        raise failed[0]

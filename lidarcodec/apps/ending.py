"""Ending threads with a time limit. Threads are daemons: one that does not end in time ends with the process."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Iterable

logger = logging.getLogger(__name__)

END_S = 20.0
"""Time limit in seconds for all threads together."""


def ended(threads: Iterable[threading.Thread], limit_s: float = END_S) -> bool:
    """Wait for started threads, at most `limit_s` seconds; returns whether all have ended.

    Threads that have not are abandoned and named in the log.
    """
    end = time.monotonic() + limit_s
    begun = [one for one in threads if one.ident is not None and one is not threading.current_thread()]
    for thread in begun:
        thread.join(max(0.0, end - time.monotonic()))
    late = [thread.name for thread in begun if thread.is_alive()]
    if late:
        logger.warning("not finished after %g s, so they were abandoned: %s", limit_s, ", ".join(late))
    return not late

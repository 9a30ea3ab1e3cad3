"""What keeps a program whole at its end: threads of the network library that are still at work are waited for.

They outlive a closed session by a moment, and by a long one on a machine that is busy. One that asks for the
interpreter while that is going down aborts the whole process ("FATAL: exception not rethrown").
"""

from __future__ import annotations

import atexit
import signal
import threading
import time
from pathlib import Path
from typing import Final

CLOSING: Final = "close"
"""How names of threads begin that give something back to the network."""
LEAST_S: Final = 0.1
MOST_S: Final = 5.0
LOOK_S: Final = 0.02
STUCK_S: Final = 10
TASKS: Final = Path("/proc/self/task")


def let_late_threads_end_at_exit() -> None:
    """Before anything else that was registered until now; once, however often it is called."""
    atexit.unregister(_let_late_threads_end)
    atexit.register(_let_late_threads_end)


def _let_late_threads_end() -> None:
    end_s = time.monotonic() + MOST_S
    for thread in threading.enumerate():
        if thread.name.startswith(f"{CLOSING} "):
            thread.join(max(0.0, end_s - time.monotonic()))
            if thread.is_alive():
                _end_even_if_stuck()
    time.sleep(LEAST_S)
    before = None
    while time.monotonic() < end_s:
        now = _asleep()
        if now is not None and now == before:
            return
        before = now
        time.sleep(LOOK_S)


def _end_even_if_stuck() -> None:
    """Have the system end the process in STUCK_S, by SIGALRM. A library that failed while it held a lock, as without
    memory, can hold up the end of the interpreter for ever, and handlers of Python do not run any more."""
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.alarm(STUCK_S)


def _asleep() -> dict[str, bytes] | None:
    """How often each thread that Python did not start has gone to sleep so far, by its number; None while one of them
    runs, or waits for a processor. Empty where the system does not tell."""
    own, found = {str(thread.native_id) for thread in threading.enumerate()}, {}
    try:
        others = [task for task in TASKS.iterdir() if task.name not in own]
    except OSError:
        return {}
    for task in others:
        try:
            status = (task / "status").read_bytes()
        except OSError:  # it has ended
            continue
        if b"\nState:\tR" in status or b"\nState:\tD" in status:
            return None
        found[task.name] = status.partition(b"\nvoluntary_ctxt_switches:")[2]
    return found

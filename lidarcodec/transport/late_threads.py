"""Waits for threads of the network library at the end of the program.

They live a moment longer than a closed session, or much longer on a busy machine. If one of them calls the interpreter
while it shuts down, the whole process aborts ("FATAL: exception not rethrown").
"""

from __future__ import annotations

import atexit
import signal
import threading
import time
from pathlib import Path
from typing import Final

CLOSING: Final = "close"
"""Name prefixes of our own threads that close something on the network."""
LEAST_S: Final = 0.1
MOST_S: Final = 5.0
LOOK_S: Final = 0.02
STUCK_S: Final = 10
TASKS: Final = Path("/proc/self/task")


def let_late_threads_end_at_exit() -> None:
    """Register the wait at exit. It runs before everything registered earlier. Further calls do nothing."""
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
    """Let the system end the process after STUCK_S, by SIGALRM. If a library failed while it held a lock, for example
    without memory, the interpreter may never end, and Python's handlers no longer run."""
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.alarm(STUCK_S)


def _asleep() -> dict[str, bytes] | None:
    """How often each thread that Python did not start has slept so far, by its number; None while one of them runs or
    waits for a processor. Empty if the system does not provide this."""
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

"""If these fail, a program that used the network dies with "exception not rethrown" when all its work is done."""

from __future__ import annotations

import signal
import subprocess
import sys

import pytest

from tests.command_line import environment

LATE = """
import _thread, os, threading, time, zlib
from lidarcodec.transport import late_threads

late_threads.MOST_S = 90.0
late_threads.let_late_threads_end_at_exit()
late_threads.let_late_threads_end_at_exit()

def work():
    zlib.compress(bytes(os.urandom(1 << 14)) * 1024, 9)  # without the interpreter, which is asked for at its end
    os.write(1, b"ended")

"""
STARTS = {
    "a thread of a library": "_thread.start_new_thread(work, ())",
    "one that gives back": "threading.Thread(target=work, name=late_threads.CLOSING + ' it', daemon=True).start()",
}


def run(code: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", code]
    return subprocess.run(command, capture_output=True, text=True, env=environment(), timeout=120, check=False)


@pytest.mark.parametrize("start", STARTS.values(), ids=STARTS)
def test_a_thread_that_is_at_work_at_the_end_may_finish(start):
    ended = run(LATE + start)
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, "ended", "")


def test_a_library_that_hangs_at_the_end_is_ended_by_the_system():
    """A service manager would otherwise wait for it for ever, and no signal but SIGKILL would end it."""
    stuck = """
import atexit, ctypes
atexit.register(lambda: ctypes.PyDLL(None).pause())  # runs after ours, with the interpreter's lock held
late_threads.let_late_threads_end_at_exit()
late_threads.MOST_S, late_threads.STUCK_S = 0.5, 1
threading.Thread(target=time.sleep, args=(1e6,), name=late_threads.CLOSING + ' it', daemon=True).start()
"""
    assert run(LATE + stuck).returncode == -signal.SIGALRM


@pytest.mark.sweep
def test_one_that_never_ends_holds_up_no_exit():
    own = "threading.Thread(target=lambda: [None for _ in iter(int, 1)], daemon=True).start()"
    assert run(LATE + own).returncode == 0
    waits = "late_threads.MOST_S = 0.5\n_thread.start_new_thread(time.sleep, (1e6,))"
    assert run(LATE + waits).returncode == 0
    spins = "late_threads.MOST_S = 0.5\n_thread.start_new_thread(lambda: [None for _ in iter(int, 1)], ())"
    assert run(LATE + spins).returncode == 0

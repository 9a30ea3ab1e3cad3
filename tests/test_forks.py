"""Programs that tests start end with the tests, however those ended: none is left that keeps a core busy."""

import json
import os
import select
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests import forks

ROOT = Path(__file__).resolve().parent.parent
LIMIT_MS = 60_000
WAITING = "import time; time.sleep(600)"
STUBBORN = f"import signal; signal.signal(signal.SIGTERM, signal.SIG_IGN); {WAITING}"
ASKER = """
import json, sys, time
from tests import forks
forks._templates.append(forks.Template(imports=False))
program = forks.Process([sys.executable, "-m", "timeit", "-n1", "-r1", "print('begun', flush=True); " + sys.argv[1]])
print(json.dumps([forks._templates[0].pid, program.pid]), flush=True)
time.sleep(600)
"""

ENDING = """
import atexit, sys, threading, time
print('first', end=' ')
atexit.register(print, 'last')
threading.Thread(target=lambda: (time.sleep(0.2), print('second', end=' '))).start()
sys.exit(CODE)
"""
"""A program that leaves to Python what is done at its end."""

pytestmark = pytest.mark.skipif(not hasattr(os, "pidfd_open"), reason="needs descriptors of processes")


def ended(number: int) -> bool:
    """Whether the process of a descriptor ends in time."""
    return bool(select.select([number], [], [], LIMIT_MS / 1000)[0])


@pytest.mark.parametrize(
    ("killed", "program"), [("tests", WAITING), ("what it was forked from", STUBBORN)], ids=["tests", "template"]
)
def test_a_program_ends_with_those_who_asked_for_it(killed, program):
    with subprocess.Popen([sys.executable, "-c", ASKER, program], cwd=ROOT, stdout=subprocess.PIPE, text=True) as asker:
        told = sorted(asker.stdout.readline() for _ in range(2))
        assert told[1] == "begun\n"
        template, forked = json.loads(told[0])
        ends = [os.pidfd_open(number) for number in (template, forked)]
        os.kill(asker.pid if killed == "tests" else template, signal.SIGKILL)
        try:
            assert all(map(ended, ends)), "a program is left behind"
        finally:
            asker.kill()
            for end in ends:
                os.close(end)


@pytest.mark.parametrize("code", ["None", "3", "'a reason'", "1 / 0"])
def test_a_forked_program_ends_as_any_other(code, tmp_path):
    """What it had still to do or to print was lost, or it ended with another code."""
    (tmp_path / "ending.py").write_text(ENDING.replace("CODE", code))
    words = [sys.executable, "-m", "ending"]
    forked = forks.Process(words, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    out, complaints = forked.communicate(timeout=LIMIT_MS / 1000)
    assert forked._channel is not None, "it was not forked"
    plain = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, timeout=LIMIT_MS / 1000, check=False)
    assert (out, forked.returncode) == (plain.stdout, plain.returncode)
    assert out == "first second last\n"
    assert complaints.splitlines()[-1:] == plain.stderr.splitlines()[-1:]

"""Importing the package changes nothing of the process that does it: programs that use it keep their own signals."""

from __future__ import annotations

import subprocess
import sys

import pytest

from tests.conftest import ROOT

SCRIPT = """
import contextlib, importlib, pkgutil, signal
before = [signal.getsignal(number) for number in signal.valid_signals()]
import lidarcodec
for found in pkgutil.walk_packages(lidarcodec.__path__, "lidarcodec."):
    if not found.name.endswith("__main__"):
        with contextlib.suppress(ModuleNotFoundError):  # what needs an extra that is not here
            importlib.import_module(found.name)
assert [signal.getsignal(number) for number in signal.valid_signals()] == before, "a signal is left otherwise"
assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0), "an alarm is set"
"""


@pytest.mark.sweep
def test_no_module_changes_signals_or_sets_an_alarm_when_it_is_imported():
    """A program that ignored SIGTERM would hand that on to every process it starts, and none of them could be ended."""
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT], cwd=ROOT, check=False, capture_output=True, text=True, timeout=200
    )
    assert done.returncode == 0, done.stderr


def test_no_python_runs_while_the_core_is_loaded() -> None:
    """A signal is raised as KeyboardInterrupt wherever Python runs; within the loading of the core that is an abort."""
    from lidarcodec import _native

    program = (
        "import atexit, sys, _imp, importlib.machinery, importlib.util\n"
        f"loader = importlib.machinery.ExtensionFileLoader('_native', {_native.__file__!r})\n"
        "spec = importlib.util.spec_from_file_location('_native', loader=loader)\n"
        "ran = []\n"
        "sys.setprofile(lambda frame, event, _: ran.append(frame.f_code.co_name) if event == 'call' else None)\n"
        "_imp.exec_dynamic(_imp.create_dynamic(spec))\n"
        "sys.setprofile(None)\n"
        "assert set(ran) <= {'<module>'}, ran"  # nanobind's own, which goes on without what was interrupted
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr[-2000:]

"""The command line in real processes, for tests: nothing of the environment's settings, and this checkout's package."""

import contextlib
import io
import os
import signal
import subprocess
import sys
from functools import cache
from pathlib import Path
from unittest import mock

from lidarcodec import cli
from lidarcodec.commands.running.options import command_line, leaves
from tests import forks

ROOT = Path(__file__).resolve().parent.parent
COMMAND = [sys.executable, "-m", "lidarcodec"]
LIMIT_S = 100


@cache
def commands():
    """Every command that does something, by its words. They are made once, when a test asks."""
    return {" ".join(words): command for words, command in leaves(command_line(cli.app))}


def environment(**more):
    """This process's environment without LIDARCODEC_ variables, but with those given.

    numpy's linear algebra starts no thread for each core, which would be a seventh of what a short command takes.
    """
    clean = {key: value for key, value in os.environ.items() if not key.startswith("LIDARCODEC_")}
    paths = [str(ROOT), str(ROOT / "server"), *filter(None, [clean.get("PYTHONPATH")])]
    return clean | {"PYTHONPATH": os.pathsep.join(paths), "OPENBLAS_NUM_THREADS": "1", "PYTHONFAULTHANDLER": "1"} | more


class Running(forks.Process):
    """A command that runs. If it does not end in time, the test fails with the stacks of its threads."""

    def communicate(self, input=None, timeout=None):
        try:
            return super().communicate(input, timeout)
        except subprocess.TimeoutExpired:
            self.send_signal(signal.SIGABRT)
            said = super().communicate(timeout=LIMIT_S)
            raise AssertionError(f"{self.args} did not end within {timeout} s: {said}") from None


def start(*words, variables=None, **options):
    """A command that runs; its output comes as text through pipes."""
    return Running(
        [*COMMAND, *map(str, words)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment(**(variables or {})),
        **options,
    )


def run(*words, cwd=None, limit_s=LIMIT_S, **variables):
    """A command from beginning to end: `returncode`, `stdout` and `stderr`."""
    with start(*words, variables=variables, cwd=cwd) as process:
        try:
            out, complaints = process.communicate(timeout=limit_s)
        except BaseException:
            process.kill()
            raise
    return subprocess.CompletedProcess(process.args, process.returncode, out, complaints)


def run_here(*words):
    """The same within this process, in a fraction of the time: for what is refused before it runs, or only prepares."""
    out, complaints = io.StringIO(), io.StringIO()
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    try:
        with (
            contextlib.redirect_stdout(out),
            contextlib.redirect_stderr(complaints),
            mock.patch.dict(os.environ, environment(), clear=True),
        ):
            code = cli.run([str(word) for word in words])
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    return subprocess.CompletedProcess(words, code, out.getvalue(), complaints.getvalue())


def the_one_line(result):
    """What stands on stderr, if that is one line, as an error has to be."""
    lines = result.stderr.splitlines()
    assert len(lines) == 1, result.stderr
    return lines[0]

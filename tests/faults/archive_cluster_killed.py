"""Scheduler, workers and driver of a Dask cluster are killed (SIGKILL) at random moments, until all is done.

What was killed is started again at once, as a supervisor does it.
"""

from __future__ import annotations

import contextlib
import random
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

from tests import command_line
from tests.faults.archive_killed import objects, undisturbed, words
from tests.faults.outcome import Outcome
from tests.transport.conftest import free_port

KILLS = 100
SEED = 34
WORKERS = 2
SHARES = {"scheduler": 0.25, "driver": 0.25, "worker": 0.5}
KILLS_OF_A_ROUND = 8
PATIENCE_S = 600.0


class Cluster:
    """A scheduler and workers. folder: where workers keep their files"""

    def __init__(self, folder: Path) -> None:
        self._folder, self._port = folder, free_port()
        self.address = f"tcp://127.0.0.1:{self._port}"
        self.scheduler = self._start("scheduler")
        self.workers = [self._start("worker") for _ in range(WORKERS)]

    def _start(self, role: str) -> subprocess.Popen[bytes]:
        here = ["--host", "127.0.0.1", "--no-dashboard"]
        more = {
            "scheduler": ["--port", str(self._port)],
            "worker": ["--nthreads", "1", "--no-nanny", "--death-timeout", "60", self.address],
        }
        command = [sys.executable, "-m", f"distributed.cli.dask_{role}", *here, *more[role]]
        none = subprocess.DEVNULL
        return subprocess.Popen(command, cwd=self._folder, env=command_line.environment(), stdout=none, stderr=none)

    def mend(self) -> None:
        """Start again what has ended."""
        if self.scheduler.poll() is not None:
            self.scheduler = self._start("scheduler")
        self.workers = [one if one.poll() is None else self._start("worker") for one in self.workers]

    def close(self) -> None:
        for process in (*self.workers, self.scheduler):
            process.kill()
            process.wait()


@contextlib.contextmanager
def cluster(folder: Path) -> Iterator[Cluster]:
    found = Cluster(folder)
    try:
        yield found
    finally:
        found.close()


def run(kills: int = KILLS, seed: int = SEED) -> Outcome:
    """Rounds with a fresh archive each, until so many processes were killed."""
    title = "scheduler, workers and driver of `archive run --workers dask` killed"
    if find_spec("distributed") is None:
        return Outcome(title, None, "?", "?", {"note": "not run: the extra `cluster` is not installed"})
    moments, counts, wrong = random.Random(seed), dict.fromkeys(SHARES, 0), []
    with tempfile.TemporaryDirectory() as name, cluster(Path(name)) as found:
        folder = Path(name)
        expected = undisturbed(folder)
        number = 0
        while sum(counts.values()) < kills:
            number += 1
            _disturbed(folder, f"round-{number}", found, moments, counts, kills)
            if objects(folder / f"round-{number}") != expected:
                wrong.append(f"round {number} has other objects than an undisturbed run")
    total = sum(counts.values())
    return Outcome(
        title,
        None,
        "nothing: the same objects, byte for byte, as of an undisturbed run",
        "driver: `tried_again`; a scheduler that is back within a minute gets the tasks again",
        {"note": f"{total} kills, {counts['scheduler']} of the scheduler, {counts['driver']} of the driver"},
        wrong,
    )


def _disturbed(
    folder: Path, out: str, found: Cluster, moments: random.Random, counts: dict[str, int], kills: int
) -> None:
    """One archive, from nothing to complete. Raises TimeoutError if it does not become complete."""
    begun_s, in_round = time.monotonic(), 0
    while True:
        found.mend()
        driver = command_line.start("archive", *words(folder, out, "--workers", "dask", "--scheduler", found.address))
        while driver.poll() is None:
            if time.monotonic() - begun_s > PATIENCE_S:
                driver.kill()
                raise TimeoutError(f"{out} is not complete after {PATIENCE_S:g} s")
            with contextlib.suppress(subprocess.TimeoutExpired):
                driver.wait(moments.uniform(0.1, 4.0))
                break
            found.mend()
            if in_round == KILLS_OF_A_ROUND or sum(counts.values()) >= kills:
                continue
            (who,) = moments.choices(list(SHARES), list(SHARES.values()))
            victims = {"scheduler": found.scheduler, "driver": driver, "worker": moments.choice(found.workers)}
            victims[who].kill()
            victims[who].wait()
            counts[who] += 1
            in_round += 1
        driver.communicate()
        if driver.returncode == 0:
            return

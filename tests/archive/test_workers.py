"""Real workers: processes that are killed or hang, and a Dask cluster of processes."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import pytest

from lidarcodec.archive.driver import drive
from lidarcodec.archive.engines.guarded import guarded
from lidarcodec.archive.engines.processes import ProcessEngine
from lidarcodec.archive.stores.folder import FolderStore
from lidarcodec.archive.tasks import Task
from tests.archive.test_archive import FRAMES, objects
from tests.command_line import environment, run
from tests.transport.conftest import free_port

pytestmark = [pytest.mark.sweep, pytest.mark.timeout(300)]


GREEDY = """
from lidarcodec.archive.jobs.table import JOBS, Job

JOBS["greedy"] = Job("segment", "greedy:take")
"""
TAKES = """
import time

def take(value, source, target):
    held = bytes(b"x" * (value["mb"] * 10**6))
    time.sleep(value["s"])
    return {"bytes": len(held)}
"""


class Greedy:
    """A plan of a job of one's own that takes memory."""

    def __init__(self, folder: Path, *mb: int) -> None:
        self.counts: Counter = Counter()
        self._tasks = [
            Task(
                "greedy", f"{number}-0", f"task {number}", str(folder), str(folder), {"mb": one, "s": 60 * (one > 200)}
            )
            for number, one in enumerate(mb)
        ]

    def tasks(self):
        return iter(self._tasks)

    def after(self, ended):
        return iter(())


@pytest.fixture
def greedy(tmp_path, monkeypatch):
    """A folder whose modules bring that job to every worker."""
    (tmp_path / "sitecustomize.py").write_text(GREEDY)
    (tmp_path / "greedy.py").write_text(TAKES)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    return tmp_path


def test_a_task_that_takes_too_much_memory_is_set_aside_and_stops_no_other(greedy):
    engine = ProcessEngine(1, 300.0, memory_mb=300)
    try:
        outcome = drive(Greedy(greedy, 50, 900, 51), engine, FolderStore(greedy), pause_s=0.0)
    finally:
        engine.close()
    assert outcome.aside == [("task 1", "it needed more than 300 MB of memory")]
    assert (outcome.tasks, outcome.counts["bytes"], outcome.counts["tried_again"]) == (2, 101 * 10**6, 2)


def test_a_worker_of_a_cluster_ends_what_takes_too_much_and_lives_on(greedy):
    (large,), (small,) = (list(Greedy(greedy, mb).tasks()) for mb in (900, 50))
    assert guarded(large, 300.0, 300).how == "large"
    assert guarded(small, 300.0, 300).result == {"bytes": 50 * 10**6}
    assert guarded(large, 0.5, None).how == "late"


def test_a_worker_whose_parent_is_gone_ends_itself(tmp_path):
    program = (
        "import sys, time\n"
        "from lidarcodec.archive.engines.processes import ProcessEngine\n"
        "from lidarcodec.archive.tasks import Task\n"
        "engine = ProcessEngine(1, 60.0)\n"
        "engine.submit(Task('cut', 'key', 'label', sys.argv[1], sys.argv[1], {'input': {}}))\n"
        "assert engine.ended(60.0)\n"
        "print(engine.pids[0], flush=True)\n"
        "time.sleep(60)\n"
    )
    words = [sys.executable, "-c", program, str(tmp_path)]
    with subprocess.Popen(words, env=environment(), stdout=subprocess.PIPE, text=True) as parent:
        worker = Path(f"/proc/{int(parent.stdout.readline())}")
        parent.kill()
    end_s = time.monotonic() + 60.0
    while worker.exists() and (worker / "stat").read_text().rpartition(")")[2].split()[0] != "Z":
        assert time.monotonic() < end_s
        time.sleep(0.05)


def test_a_worker_that_dies_or_takes_too_long_is_replaced(tmp_path):
    engine = ProcessEngine(1, timeout_s=60.0)
    task = Task("cut", "key", "label", str(tmp_path), str(tmp_path / "out"), {"input": {}})
    try:
        engine.submit(task)
        os.kill(engine.pids[0], signal.SIGKILL)
        (ended,) = engine.ended(30.0)
        assert (ended.how, ended.why) == ("killed", "its process ended with SIGKILL")
        engine.submit(task)
        (ended,) = engine.ended(60.0)
        assert ended.how == "failed"
    finally:
        engine.close()
    late = ProcessEngine(1, timeout_s=0.01)
    try:
        late.submit(task)
        (ended,) = late.ended(30.0)
        assert ended.how == "late"
        assert late.pids == []
    finally:
        late.close()


def test_a_dask_cluster_writes_the_same_objects(drive, tmp_path):
    pytest.importorskip("distributed", reason="needs the extra cluster")
    port = free_port()
    scheduler = f"tcp://127.0.0.1:{port}"
    options = {"env": environment(), "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    words = ["scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard"]
    processes = [subprocess.Popen([sys.executable, "-m", "distributed.cli.dask_scheduler", *words[1:]], **options)]
    try:
        for _ in range(2):
            worker = ["--nthreads", "1", "--host", "127.0.0.1", "--no-dashboard", "--no-nanny", scheduler]
            processes.append(
                subprocess.Popen(
                    [sys.executable, "-m", "distributed.cli.dask_worker", *worker], cwd=tmp_path, **options
                )
            )
        time.sleep(2.0)
        words = ["archive", "run", drive, tmp_path / "dask", "--seconds", "1", "--json"]
        done = run(*words, "--workers", "dask", "--scheduler", scheduler)
        assert done.returncode == 0, done.stderr
        assert json.loads(done.stdout)["frames"] == FRAMES
    finally:
        for process in processes:
            process.kill()
            process.wait()
    plain = run("archive", "run", drive, tmp_path / "plain", "--seconds", "1", "--processes", "1")
    assert plain.returncode == 0, plain.stderr
    assert objects(tmp_path / "dask") == objects(tmp_path / "plain")


def test_a_ray_cluster_writes_the_same_objects(drive, tmp_path):
    pytest.importorskip("ray", reason="needs the extra ray")
    port = free_port()
    program = [sys.executable, Path(sys.executable).with_name("ray")]
    words = ["start", "--head", "--port", str(port), "--num-cpus", "2", "--include-dashboard", "false"]
    options = {"env": environment() | {"RAY_USAGE_STATS_ENABLED": "0"}, "capture_output": True}
    subprocess.run([*program, *words, "--node-ip-address", "127.0.0.1"], check=True, **options)
    try:
        words = ["archive", "run", drive, tmp_path / "ray", "--seconds", "1", "--json"]
        done = run(*words, "--workers", "ray", "--scheduler", f"127.0.0.1:{port}")
        assert done.returncode == 0, done.stderr
        assert json.loads(done.stdout)["frames"] == FRAMES
    finally:
        subprocess.run([*program, "stop"], check=True, **options)
    plain = run("archive", "run", drive, tmp_path / "plain", "--seconds", "1", "--processes", "1")
    assert plain.returncode == 0, plain.stderr
    assert objects(tmp_path / "ray") == objects(tmp_path / "plain")


def test_no_cluster_is_one_line(drive, tmp_path):
    pytest.importorskip("distributed", reason="needs the extra cluster")
    address = f"tcp://127.0.0.1:{free_port()}"
    done = run("archive", "run", drive, tmp_path / "out", "--workers", "dask", "--scheduler", address)
    assert done.returncode == 1
    assert f"no Dask cluster with workers at {address}" in done.stderr
    assert len(done.stderr.splitlines()) == 1

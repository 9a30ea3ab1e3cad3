"""The engine for Dask, with a cluster in this process."""

from __future__ import annotations

import time
from importlib import import_module

import pytest

from lidarcodec.archive.engines import dask
from lidarcodec.archive.tasks import Ended, Task

TASK = Task("cut", "key", "label", "/nowhere", "/nowhere", {"input": {}})


def slow(task: Task, timeout_s: float, memory_mb: int | None) -> Ended:
    time.sleep(0.5)
    return Ended(task, "done")


class NotThere:
    """A function that a worker cannot load."""

    def __call__(self, task):
        raise AssertionError("it cannot be called")

    def __reduce__(self):
        return import_module, ("lidarcodec_is_not_there",)


@pytest.fixture
def engine():
    distributed = pytest.importorskip("distributed", reason="needs the extra cluster")
    options = {"n_workers": 1, "threads_per_worker": 2, "processes": False, "dashboard_address": None}
    with distributed.LocalCluster(host="127.0.0.1", protocol="tcp://", **options) as cluster:
        found = dask.DaskEngine(cluster.scheduler_address, timeout_s=30.0)
        yield found
        found.close()


def ended(engine):
    end_s = time.monotonic() + 30.0
    while not (found := engine.ended(0.2)):
        assert time.monotonic() < end_s
    return found[0]


@pytest.mark.sweep
def test_as_many_tasks_are_handed_out_as_can_run_and_a_worker_without_the_package_says_so(engine, monkeypatch):
    assert engine.slots == 2
    engine.submit(TASK)
    assert ended(engine).how == "failed"
    monkeypatch.setattr(dask, "done_here", NotThere())
    engine.submit(TASK)
    found = ended(engine)
    assert (found.how, "lidarcodec_is_not_there" in found.why) == ("missing", True)


def test_the_thread_of_a_late_task_gets_no_other_until_it_ends(engine, monkeypatch):
    monkeypatch.setattr(dask, "done_here", slow)
    monkeypatch.setattr(dask, "_GRACE_S", 0.0)
    engine._timeout_s = 0.1
    engine.submit(TASK)
    assert (ended(engine).how, engine.slots) == ("late", 1)
    engine._timeout_s = 30.0
    time.sleep(0.5)
    engine.submit(TASK)
    assert (ended(engine).how, engine.slots) == ("done", 2)

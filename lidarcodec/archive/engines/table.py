"""The table of engines."""

from __future__ import annotations

import os
from importlib.util import find_spec
from typing import Final, NamedTuple

from lidarcodec.archive.engines.base import Engine
from lidarcodec.archive.engines.worker import STATUS
from lidarcodec.errors import MissingExtraError, SettingsError, UnknownNameError

ENGINES: Final = ("processes", "dask", "ray", "here")
CLUSTERS: Final = {"dask": "tcp://10.0.0.5:8786", "ray": "ray://10.0.0.5:10001"}
"""Engines that need an address, and an example of one."""
_EXTRAS: Final = {"dask": ("distributed", "cluster"), "ray": ("ray", "ray")}
"""The package that an engine needs, and its extra."""
WORKERS: Final = "processes"
"""The default."""
TIMEOUT_S: Final = 1800.0


class Wishes(NamedTuple):
    """Options of an engine, None if not given.

    scheduler: address of a cluster;  processes: how many;  timeout_s, memory_mb: limits of a task
    """

    scheduler: str | None = None
    processes: int | None = None
    timeout_s: float | None = None
    memory_mb: int | None = None


def check_engine(name: str, wishes: Wishes) -> None:
    """Raise UnknownNameError, SettingsError or MissingExtraError for an engine that cannot be made."""
    if name not in ENGINES:
        raise UnknownNameError("engine", name, ENGINES)
    if name in CLUSTERS and wishes.scheduler is None:
        raise SettingsError(f"--workers {name} needs --scheduler ADDRESS, such as {CLUSTERS[name]}", "scheduler")
    if name not in CLUSTERS and wishes.scheduler is not None:
        raise SettingsError(f"--scheduler is only for --workers {' and '.join(CLUSTERS)}", "scheduler")
    if name != "processes" and wishes.processes is not None:
        raise SettingsError("--processes is only for --workers processes", "processes")
    for option, value in (("timeout", wishes.timeout_s), ("memory", wishes.memory_mb)):
        if name == "here" and value is not None:
            raise SettingsError(
                f"--{option} does not work with --workers here, where a task cannot be ended without the "
                "command: leave it out",
                option,
            )
    if name == "processes" and wishes.memory_mb is not None and not STATUS.exists():
        raise SettingsError(f"--memory works only on Linux, because it needs {STATUS}", "memory")
    if name in _EXTRAS and find_spec(_EXTRAS[name][0]) is None:
        raise MissingExtraError(f"--workers {name}", _EXTRAS[name][1])


def make_engine(name: str, wishes: Wishes) -> Engine:
    """An engine. By default it has a process for each processor, TIMEOUT_S for a task, and no limit of memory.

    Raises as `check_engine`, and SourceError if no cluster answers.
    """
    check_engine(name, wishes)
    limits = TIMEOUT_S if wishes.timeout_s is None else wishes.timeout_s, wishes.memory_mb
    if name == "dask":
        from lidarcodec.archive.engines.dask import DaskEngine

        return DaskEngine(str(wishes.scheduler), *limits)
    if name == "ray":
        from lidarcodec.archive.engines.ray import RayEngine

        return RayEngine(str(wishes.scheduler), *limits)
    if name == "here":
        from lidarcodec.archive.engines.here import HereEngine

        return HereEngine()
    from lidarcodec.archive.engines.processes import ProcessEngine

    return ProcessEngine(wishes.processes or len(os.sched_getaffinity(0)), *limits)

"""The table of engines."""

from __future__ import annotations

import os
from importlib.util import find_spec
from typing import Final

from lidarcodec.archive.engines.base import Engine
from lidarcodec.errors import MissingExtraError, SettingsError, UnknownNameError

ENGINES: Final = ("processes", "dask", "ray", "here")
CLUSTERS: Final = {"dask": "tcp://10.0.0.5:8786", "ray": "ray://10.0.0.5:10001"}
"""Engines that need an address, and an example of one."""
_EXTRAS: Final = {"dask": ("distributed", "cluster"), "ray": ("ray", "ray")}
"""The package that an engine needs, and its extra."""
WORKERS: Final = "processes"
"""The default."""
TIMEOUT_S: Final = 1800.0


def check_engine(name: str, scheduler: str | None, count: int | None, timeout_s: float | None) -> None:
    """Raise UnknownNameError, SettingsError or MissingExtraError for an engine that cannot be made. None: not given"""
    if name not in ENGINES:
        raise UnknownNameError("engine", name, ENGINES)
    if name in CLUSTERS and scheduler is None:
        raise SettingsError(f"--workers {name} needs --scheduler ADDRESS, such as {CLUSTERS[name]}", "scheduler")
    if name not in CLUSTERS and scheduler is not None:
        raise SettingsError(f"--scheduler is only for --workers {' and '.join(CLUSTERS)}", "scheduler")
    if name != "processes" and count is not None:
        raise SettingsError("--processes is only for --workers processes", "processes")
    if name == "here" and timeout_s is not None:
        raise SettingsError(
            "--timeout is not for --workers here: a task cannot be ended without the command", "timeout"
        )
    if name in _EXTRAS and find_spec(_EXTRAS[name][0]) is None:
        raise MissingExtraError(f"--workers {name}", _EXTRAS[name][1])


def make_engine(name: str, scheduler: str | None, count: int | None, timeout_s: float | None) -> Engine:
    """An engine. count: worker processes, by default one for each processor;  timeout_s: of a task, TIMEOUT_S if None

    Raises as `check_engine`, and SourceError if no cluster answers.
    """
    check_engine(name, scheduler, count, timeout_s)
    limit_s = TIMEOUT_S if timeout_s is None else timeout_s
    if name == "dask":
        from lidarcodec.archive.engines.dask import DaskEngine

        return DaskEngine(str(scheduler), limit_s)
    if name == "ray":
        from lidarcodec.archive.engines.ray import RayEngine

        return RayEngine(str(scheduler), limit_s)
    if name == "here":
        from lidarcodec.archive.engines.here import HereEngine

        return HereEngine()
    from lidarcodec.archive.engines.processes import ProcessEngine

    return ProcessEngine(count or len(os.sched_getaffinity(0)), limit_s)

"""`lidarcodec archive run`: does a job on everything in a store."""

from __future__ import annotations

import json
import logging
from dataclasses import dataclass
from typing import Any, Final

from lidarcodec.archive.archive import time_ns
from lidarcodec.archive.driver import Outcome, Plan, drive
from lidarcodec.archive.engines.table import check_engine, make_engine
from lidarcodec.archive.index import index
from lidarcodec.archive.plan import CommitPlan, CompressPlan, archive_settings
from lidarcodec.archive.repair import repair
from lidarcodec.archive.stores.base import Store
from lidarcodec.archive.stores.table import open_store
from lidarcodec.archive.table import check_extra
from lidarcodec.commands.progress import progress
from lidarcodec.commands.running.stopping import StoppedError, stoppable
from lidarcodec.commands.settings import one_setting
from lidarcodec.errors import SettingsError, UnknownNameError
from lidarcodec.pipeline import check_offline
from lidarcodec.settings import StreamSettings

log = logging.getLogger(__name__)

JOBS: Final = ("compress", "verify", "recompress", "index")
_SHOWN: Final = 20
"""Most reasons that are printed; all are in the archive."""


@dataclass(frozen=True)
class Wanted:
    """Options of the command."""

    job: str
    codec: str | None
    pairs: list[str]
    seconds: float
    workers: str
    processes: int | None
    scheduler: str | None
    timeout_s: float
    before: str | None
    delete_old: bool
    dry: bool
    repair: bool


def run(source: str, archive: str, wanted: Wanted, as_json: bool) -> bool:
    """Do the job and print what was done. Returns whether nothing was set aside, left or found broken."""
    settings = _checked(wanted)
    inputs, target = open_store(source), open_store(archive)
    removed = repair(target) if wanted.repair else {}
    if wanted.job == "index":
        _print(index(target), as_json)
        return True
    plan = _plan(wanted, inputs, target, settings)
    if wanted.dry and wanted.job != "recompress":
        waiting = sum(1 for _ in plan.tasks())
        _print({"inputs": plan.inputs, "finished": plan.finished, "tasks": waiting, "dry_run": True}, as_json)
        return True
    engine = make_engine(wanted.workers, wanted.scheduler, wanted.processes, wanted.timeout_s)
    try:
        with stoppable() as stopped, progress(wanted.job) as tick:
            outcome = drive(plan, engine, target, stopped=stopped, tick=tick)
    finally:
        engine.close()
    result = _result(plan, outcome) | {"repaired": dict(removed), "dry_run": wanted.dry, "complete": outcome.complete}
    for label, why in (*outcome.aside, *outcome.left)[:_SHOWN]:
        log.warning("%s: %s", label, why)
    if not outcome.complete:
        raise StoppedError("stopped: run the same command again to continue")
    _print(result, as_json)
    return not (outcome.aside or outcome.left or result["broken"])


def _checked(wanted: Wanted) -> StreamSettings:
    """The settings, if all options fit each other."""
    if wanted.job not in JOBS:
        raise UnknownNameError("job", wanted.job, JOBS)
    if wanted.job != "recompress" and (wanted.delete_old or wanted.before):
        raise SettingsError("--delete-old and --before are only for --job recompress")
    if wanted.job in ("verify", "index") and (wanted.codec or wanted.pairs):
        raise SettingsError(f"--job {wanted.job} takes no settings")
    if wanted.job == "index" and wanted.dry:
        raise SettingsError("--dry-run is not for --job index")
    if wanted.job == "recompress" and not (wanted.codec or wanted.pairs):
        raise SettingsError("--job recompress needs the new settings: --codec or --set")
    check_extra()
    check_engine(wanted.workers, wanted.scheduler)
    return archive_settings(check_offline(one_setting(wanted.codec, wanted.pairs)))


def _plan(wanted: Wanted, source: Store, target: Store, settings: StreamSettings) -> Plan:
    if wanted.job == "compress":
        return CompressPlan(source, target, settings, wanted.seconds)
    more: dict[str, Any] = {}
    if wanted.job == "recompress":
        more = {
            "settings": settings.model_dump(mode="json"),
            "delete_old": wanted.delete_old,
            "dry": wanted.dry,
            "before_ns": None if wanted.before is None else time_ns(wanted.before),
        }
    return CommitPlan(wanted.job, source, target, more)


def _result(plan: Plan, outcome: Outcome) -> dict[str, Any]:
    reasons = [{"what": label, "why": why} for label, why in outcome.aside]
    left = [{"what": label, "why": why} for label, why in outcome.left]
    broken = [one for one in outcome.results if one["broken"]]
    counts = {name.replace(" ", "_"): number for name, number in sorted(outcome.counts.items())}
    return {"inputs": plan.inputs, "finished": plan.finished} | counts | {
        "aside": reasons, "left": left, "broken": broken,
    }  # fmt: skip


def _print(result: dict[str, Any], as_json: bool) -> None:
    if as_json:
        print(json.dumps(result, indent=2))
        return
    parts = [f"{value:,} {name.replace('_', ' ')}" for name, value in result.items() if isinstance(value, int)
             and not isinstance(value, bool) and (value or name in ("inputs", "finished"))]  # fmt: skip
    print(", ".join(parts))
    for name in ("aside", "left", "broken"):
        if found := result.get(name):
            print(f"{name}: {len(found)}")
    for one in result.get("broken", []):
        print(f"BROKEN {one['object']}: {'; '.join(one['broken'])}")

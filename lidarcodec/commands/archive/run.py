"""`lidarcodec archive run`: does a job on everything in a store."""

from __future__ import annotations

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
from lidarcodec.commands.running.telling import tell
from lidarcodec.commands.settings import one_setting
from lidarcodec.errors import SettingsError, UnknownNameError
from lidarcodec.pipeline import check_offline
from lidarcodec.settings import StreamSettings

log = logging.getLogger(__name__)

JOBS: Final = ("compress", "verify", "recompress", "index")
NUMBERS: Final = (
    "inputs", "finished", "tasks", "segments", "frames", "packet_bytes", "bytes", "bytes_before", "unchanged",
    "compared", "joined", "removed", "tried_again", "done_twice",
)  # fmt: skip
"""Numbers of a result, as in `results.archive.ArchiveRun`."""
_SAID: Final = {"aside": "set aside", "left": "left for the next run", "broken": "broken"}
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
    if wanted.job == "compress" and f"{target.url.rstrip('/')}/".startswith(f"{inputs.url.rstrip('/')}/"):
        raise SettingsError(f"{archive} lies in {source}: it would be read as input. Choose another OUT", "out")
    result = _nothing(wanted)
    if wanted.repair:
        result["repaired"] = dict(repair(target, inputs))
    if wanted.job == "index":
        joined = index(target)
        result |= {"joined": joined["joined"], "segments": joined["segments"], "removed": joined["removed"]}
        tell(result, _text(result), as_json)
        return True
    plan = _plan(wanted, inputs, target, settings)
    if wanted.dry and wanted.job != "recompress":
        result["tasks"] = sum(1 for _ in plan.tasks())
        result |= {"inputs": plan.inputs, "finished": plan.finished}
        tell(result, _text(result), as_json)
        return True
    engine = make_engine(wanted.workers, wanted.scheduler, wanted.processes, wanted.timeout_s)
    try:
        with stoppable() as stopped, progress(wanted.job) as tick:
            outcome = drive(plan, engine, target, stopped=stopped, tick=tick)
    finally:
        engine.close()
    for label, why in (*outcome.aside, *outcome.left)[:_SHOWN]:
        log.warning("%s: %s", label, why)
    if not outcome.complete:
        raise StoppedError("stopped: run the same command again to continue")
    _fill(result, plan, outcome, wanted.job)
    tell(result, _text(result), as_json)
    return not (outcome.aside or outcome.left or result["broken"])


def _checked(wanted: Wanted) -> StreamSettings:
    """The settings, if all options fit each other."""
    if wanted.job not in JOBS:
        raise UnknownNameError("job", wanted.job, JOBS)
    if wanted.job != "recompress" and (wanted.delete_old or wanted.before):
        raise SettingsError("--delete-old and --before are only for --job recompress")
    if wanted.job in ("verify", "index") and (wanted.codec or wanted.pairs):
        raise SettingsError(f"--job {wanted.job} takes no settings")
    if wanted.repair and wanted.dry:
        raise SettingsError("--repair removes objects: give it without --dry-run")
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


def _nothing(wanted: Wanted) -> dict[str, Any]:
    """The result of a run that did nothing."""
    numbers = dict.fromkeys(NUMBERS, 0)
    lists: dict[str, list[Any]] = {"aside": [], "left": [], "broken": []}
    return {"job": wanted.job} | numbers | {"repaired": {}} | lists | {"dry_run": wanted.dry}


def _fill(result: dict[str, Any], plan: Plan, outcome: Outcome, job: str) -> None:
    """Set in the result what a run did."""
    result |= {"inputs": plan.inputs, "finished": plan.finished, "tasks": outcome.tasks}
    result |= {name: outcome.counts[name] for name in NUMBERS if name in outcome.counts}
    result["segments"] = outcome.counts[job] - result["unchanged"]
    result["aside"] = [{"what": label, "why": why} for label, why in outcome.aside]
    result["left"] = [{"what": label, "why": why} for label, why in outcome.left]
    result["broken"] = [{"object": one["object"], "broken": one["broken"]} for one in outcome.results if one["broken"]]


def _text(result: dict[str, Any]) -> str:
    """The result in lines: numbers that are not 0, and broken recordings."""
    numbers = [f"{result[name]:,} {name.replace('_', ' ')}" for name in NUMBERS
               if result[name] or name in ("inputs", "finished")]  # fmt: skip
    numbers += [f"{number:,} removed by --repair: {name}" for name, number in result["repaired"].items()]
    numbers += [f"{len(result[name]):,} {said}" for name, said in _SAID.items() if result[name]]
    return "\n".join(
        [", ".join(numbers), *(f"BROKEN {one['object']}: {'; '.join(one['broken'])}" for one in result["broken"])]
    )

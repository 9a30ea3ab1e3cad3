"""`lidarcodec archive run`: does a job on everything in a store."""

from __future__ import annotations

import json
import logging
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from lidarcodec.archive.archive import time_ns
from lidarcodec.archive.driver import Outcome, Plan, drive
from lidarcodec.archive.engines.table import WORKERS, Wishes, check_engine, make_engine
from lidarcodec.archive.index import index
from lidarcodec.archive.jobs.recompress import REDUCING
from lidarcodec.archive.jobs.table import Job, job_of, takers, work_of
from lidarcodec.archive.names import Commit
from lidarcodec.archive.plan import Choice, CompressPlan, SegmentPlan, archive_settings
from lidarcodec.archive.policy import Policy
from lidarcodec.archive.repair import repair
from lidarcodec.archive.segments import SECONDS
from lidarcodec.archive.squares import MapPlan
from lidarcodec.archive.stores.base import Store
from lidarcodec.archive.stores.table import check_there, open_store
from lidarcodec.archive.table import check_extra
from lidarcodec.archive.verified import Verified
from lidarcodec.commands.archive.jobs.convert import check_form, stem_of
from lidarcodec.commands.progress import progress
from lidarcodec.commands.running.stopping import StoppedError, stoppable
from lidarcodec.commands.running.telling import tell
from lidarcodec.commands.settings import one_setting
from lidarcodec.errors import SettingsError, SourceError
from lidarcodec.pipeline import check_offline
from lidarcodec.settings import StreamSettings

logger = logging.getLogger(__name__)

NUMBERS: Final = (
    "inputs", "finished", "other_settings", "unfinished", "changed", "earlier_aside", "tasks", "segments",
    "frames", "packet_bytes", "bytes", "bytes_before", "unchanged", "compared", "points", "second_returns_left_out",
    "joined", "removed", "lost", "tried_again", "done_twice",
)  # fmt: skip
"""Numbers of a result, as in `results.archive.ArchiveRun`."""
_NOUNS: Final = frozenset({"inputs", "tasks", "segments", "frames", "packet_bytes", "bytes", "points"})
_WORDS: Final = {
    "finished": "finished before",
    "other_settings": "with other settings",
    "earlier_aside": "set aside earlier",
    "lost": "without a table",
}
"""Words for numbers that are not called by their names."""
_SAID: Final = {"aside": "set aside", "left": "left for the next run", "broken": "broken"}
_SHOWN: Final = 20
"""Most reasons that are printed; all are in the archive."""
_WORKING: Final = ("workers", "processes", "scheduler", "timeout", "memory")


@dataclass(frozen=True)
class Wanted:
    """Options of the command; None, False or empty if not given."""

    job: str
    codec: str | None
    pairs: list[str]
    seconds: float | None
    keep_both: bool
    policy: Path | None
    form: str | None
    before: str | None
    delete_old: bool
    dry_run: bool
    repair: bool
    workers: str | None
    processes: int | None
    scheduler: str | None
    timeout: float | None
    memory: int | None

    @property
    def wishes(self) -> Wishes:
        """Those for the engine."""
        return Wishes(self.scheduler, self.processes, self.timeout, self.memory)


def run(source: str, archive: str, wanted: Wanted, as_json: bool) -> bool:
    """Do the job and print what was done. Returns whether nothing was set aside, now or earlier, left, broken, or left
    out because its table is lost."""
    job, settings = _checked(wanted)
    inputs, target = open_store(source), open_store(archive)
    if job.each == "input" and f"{target.url.rstrip('/')}/".startswith(f"{inputs.url.rstrip('/')}/"):
        raise SettingsError(f"{archive} lies in {source} and would be read as input: choose another OUT", "out")
    if wanted.repair and job.leaves:
        raise SettingsError(
            f"--repair works only on an archive, but --job {wanted.job} does not write one: leave out --repair",
            "repair",
        )
    if wanted.job != "verify":  # which needs no inputs
        check_there(inputs)
    if not job.leaves and wanted.job != "compress":
        check_there(target)
    result = _nothing(wanted)
    if wanted.repair:
        result["repaired"] = dict(repair(target, inputs))
    if job.each == "archive":
        result |= work_of(wanted.job)({}, inputs, target)
        tell(result, _text(result), as_json)
        return not result["lost"]
    plan, outcome = _plan(wanted, inputs, target, settings), Outcome()
    if wanted.dry_run and not job.previews:
        result["tasks"] = sum(1 for _ in plan.tasks())
    else:
        outcome = _driven(wanted, plan, target)
        _fill(result, outcome, wanted.job)
        if job.changes and not (wanted.dry_run or outcome.left):
            result |= _joined(target)
    result |= plan.counts
    for remark in plan.remarks():
        logger.warning("%s", remark)
    tell(result, _text(result), as_json)
    missing = result["broken"] or result["unfinished"] or result["earlier_aside"] or result["lost"]
    return not (outcome.aside or outcome.left or missing)


def _checked(wanted: Wanted) -> tuple[Job, StreamSettings]:
    """The job and its settings, if all options fit each other."""
    job = job_of(wanted.job)
    given = {
        "settings": wanted.codec or wanted.pairs,
        "seconds": wanted.seconds,
        "keep_both": wanted.keep_both,
        "policy": wanted.policy,
        "as": wanted.form,
        "before": wanted.before,
        "delete_old": wanted.delete_old,
        "dry_run": wanted.dry_run,
    }
    for name, value in given.items():
        if value not in (None, False, []) and name not in job.takes:
            word = "--codec and --set are" if name == "settings" else f"--{name.replace('_', '-')} is"
            raise SettingsError(f"{word} only for --job {', '.join(takers(name))}, not for {wanted.job}", name)
    if wanted.repair and wanted.dry_run:
        raise SettingsError("--repair removes objects: give it without --dry-run")
    if wanted.job == "recompress" and bool(given["settings"]) == (wanted.policy is not None):
        raise SettingsError("--job recompress needs the new settings: --codec and --set, or --policy FILE")
    if wanted.policy is not None and wanted.before is not None:
        raise SettingsError(
            "--before cannot be combined with --policy, whose rules have after_days: leave out --before", "before"
        )
    if wanted.job == "convert":
        if wanted.form is None:
            raise SettingsError("--job convert needs a format: --as NAME", "as")
        check_form(wanted.form)
    working = [name for name in _WORKING if getattr(wanted, name) is not None]
    if job.each == "archive" and working:
        raise SettingsError(f"--job {wanted.job} runs in this process: leave out --{working[0]}", working[0])
    check_extra()
    check_engine(wanted.workers or WORKERS, wanted.wishes)
    settings = check_offline(one_setting(wanted.codec, wanted.pairs))
    other = {pair.partition("=")[0].strip() for pair in wanted.pairs} - REDUCING
    if wanted.job == "reduce" and (not settings.reduces or wanted.codec or other):
        raise SettingsError("--job reduce takes reduction=NAME and keep_points or keep_fraction, and nothing else")
    if wanted.policy is not None:
        Policy.of(wanted.policy, 0, _made)
    if wanted.before is not None:
        time_ns(wanted.before)
    return job, archive_settings(settings)


def _plan(wanted: Wanted, source: Store, target: Store, settings: StreamSettings) -> Plan:
    if wanted.job == "compress":
        return CompressPlan(source, target, settings, wanted.seconds or SECONDS, keep_both=wanted.keep_both)
    if wanted.job == "map":
        return MapPlan(source, target)
    if wanted.job == "verify":
        verified = Verified(target)
        return SegmentPlan("verify", source, target, verified.choice, done=lambda: verified.compared)
    if wanted.job == "convert":
        form = str(wanted.form)
        done = _named_in(target, f"{form}/", lambda commit: f"{stem_of(form, commit)}.json")
        return SegmentPlan("convert", source, target, lambda _: {"as": form}, archive=source, done=done)
    return SegmentPlan(wanted.job, source, target, _chosen(wanted, settings), clears=wanted.delete_old)


def _named_in(store: Store, folder: str, name: Callable[[Commit], str]) -> Callable[[], Callable[[Commit], bool]]:
    """Whether an object says that a segment was done, by one listing."""

    def listed() -> Callable[[Commit], bool]:
        names = {entry.name for entry in store.entries(folder)}
        return lambda commit: name(commit) in names

    return listed


def _chosen(wanted: Wanted, settings: StreamSettings) -> Choice:
    """What `recompress` and `reduce` make of a segment."""
    more: dict[str, Any] = {"delete_old": wanted.delete_old, "dry": wanted.dry_run}
    if wanted.policy is not None:
        policy = Policy.of(wanted.policy, time.time_ns(), _made)

        def by_policy(commit: Commit) -> dict[str, Any] | None:
            found = policy.settings_for(commit)
            return None if found is None else more | {"settings": found}

        return by_policy
    if wanted.job == "reduce":
        more |= {"settings": settings.model_dump(mode="json", include=set(REDUCING)), "adds": True}
    else:
        more |= {"settings": settings.model_dump(mode="json")}
    before_ns = None if wanted.before is None else time_ns(wanted.before)
    return lambda commit: more if before_ns is None or commit.last_ns < before_ns else None


def _made(codec: str | None, values: Mapping[str, Any]) -> StreamSettings:
    """Settings of a rule, as those of `--codec` and `--set`."""
    pairs = [f"{key}={value if isinstance(value, str) else json.dumps(value)}" for key, value in values.items()]
    return archive_settings(check_offline(one_setting(codec, pairs)))


def _driven(wanted: Wanted, plan: Plan, target: Store) -> Outcome:
    """Do all tasks, and say what could not be done."""
    engine = make_engine(wanted.workers or WORKERS, wanted.wishes)
    try:
        with stoppable() as stopped, progress(wanted.job) as tick:
            outcome = drive(plan, engine, target, stopped=stopped, tick=tick)
    finally:
        engine.close()
    for label, why in (*outcome.aside, *outcome.left)[:_SHOWN]:
        logger.warning("%s: %s", label, why)
    if not outcome.complete:
        raise StoppedError("stopped: run the same command again to continue")
    return outcome


def _joined(target: Store) -> dict[str, int]:
    """Join tables at the end of a run. They only make queries faster, so a failure is no failure of the run."""
    try:
        return index(target)
    except (OSError, SourceError, SettingsError) as error:
        logger.warning("tables were not joined (%s), so queries are slower: run --job index later", error)
        return {}


def _nothing(wanted: Wanted) -> dict[str, Any]:
    """The result of a run that did nothing."""
    numbers = dict.fromkeys(NUMBERS, 0)
    lists: dict[str, list[Any]] = {"aside": [], "left": [], "broken": [], "stats": []}
    return {"job": wanted.job} | numbers | {"repaired": {}} | lists | {"dry_run": wanted.dry_run}


def _fill(result: dict[str, Any], outcome: Outcome, job: str) -> None:
    """Set in the result what a run did."""
    result["tasks"] = outcome.tasks
    result |= {name: outcome.counts[name] for name in NUMBERS if name in outcome.counts}
    result["segments"] = outcome.counts[job] - result["unchanged"]
    result["aside"] = [{"what": label, "why": why} for label, why in outcome.aside]
    result["left"] = [{"what": label, "why": why} for label, why in outcome.left]
    result["broken"] = [{"object": one["object"], "broken": one["broken"]} for one in outcome.results if one["broken"]]


def _text(result: dict[str, Any]) -> str:
    """The result in lines: numbers that are not 0, and broken recordings."""
    numbers = [_counted(name, result[name]) for name in NUMBERS if result[name] or name in ("inputs", "finished")]
    numbers += [f"{number:,} removed by --repair: {name}" for name, number in result["repaired"].items()]
    numbers += [f"{len(result[name]):,} {said}" for name, said in _SAID.items() if result[name]]
    lines = [_line(row) for row in result["stats"]]
    if result["job"] == "stats":
        return "\n".join(lines or ["the archive is empty"])
    return "\n".join(
        [", ".join(numbers), *(f"BROKEN {one['object']}: {'; '.join(one['broken'])}" for one in result["broken"])]
    )


def _counted(name: str, number: int) -> str:
    """A number with what it counts.

    >>> _counted("inputs", 1), _counted("packet_bytes", 2000), _counted("finished", 0)
    ('1 input', '2,000 packet bytes', '0 finished before')
    """
    words = _WORDS.get(name, name.replace("_", " "))
    return f"{number:,} {words.removesuffix('s') if number == 1 and name in _NOUNS else words}"


def _line(row: dict[str, Any]) -> str:
    """Numbers of a vehicle, a sensor and a codec in a line."""
    hours = (row["last_ns"] - row["first_ns"]) / 3.6e12
    packets, size = row["packet_bytes"] or 0, row["bytes"] or 0
    ratio = f", {packets / size:.1f} times smaller" if packets and size else ""
    bound = "" if row["bound_m"] is None else f", within {row['bound_m'] * 100:g} cm"
    return (
        f"{row['vehicle']}/{row['sensor']} {row['codec']}: {_counted('segments', row['segments'])}, "
        f"{_counted('frames', row['frames'])} within {hours:.1f} h, {size / 1e9:.3f} GB{ratio}{bound}"
    )

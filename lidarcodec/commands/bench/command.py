"""`lidarcodec bench`: compares codecs and settings on one source."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from lidarcodec.commands.bench.curve import curve, operating
from lidarcodec.commands.bench.operating import OperatingPoints
from lidarcodec.commands.progress import progress
from lidarcodec.commands.running.stopping import StoppedError, interrupted_after
from lidarcodec.commands.running.telling import tell
from lidarcodec.commands.settings import sweep
from lidarcodec.commands.sources import check_finite
from lidarcodec.errors import DecodeError, MissingExtraError, SettingsError
from lidarcodec.evaluation.bench import METRICS, bench
from lidarcodec.evaluation.peers import table
from lidarcodec.evaluation.peers.run import bench_peer
from lidarcodec.evaluation.plot_operating import plot_operating
from lidarcodec.evaluation.plots import check_plot, plot_bits, plot_curves
from lidarcodec.evaluation.report import text_table
from lidarcodec.files.whole import check_free, whole
from lidarcodec.settings import StreamSettings
from lidarcodec.sources.unkept import say_unkept

PLOTS = (".png", ".svg", ".pdf")


class Job(NamedTuple):
    """One measurement. asked_for: whether the user named its codec, so that a failure ends the command"""

    name: str
    measure: Callable[..., dict[str, Any]]
    asked_for: bool = True


def run(
    source: str,
    *,
    codecs: str | None,
    pairs: list[str],
    frames: int | None,
    skip: int,
    calibration: Path | None,
    poses: Path | None,
    plot: Path | None,
    as_json: bool,
    metrics: str = "usual",
    as_curve: bool = False,
    peers: bool = False,
    learn: int = 0,
    force: bool = False,
) -> None:
    """Measure each setting and print the results. After a signal, print the finished ones and an error."""
    if metrics not in METRICS:
        raise SettingsError(f"--metrics must be {' or '.join(METRICS)}, not '{metrics}'", "metrics")
    if plot is not None and plot.suffix.lower() not in PLOTS:
        raise SettingsError(f"cannot draw {plot}: the name must end in {' or '.join(PLOTS)}", "plot")
    if plot is not None and not plot.parent.is_dir():  # checked before measurements that may take an hour
        raise SettingsError(f"cannot draw {plot}: there is no folder {plot.parent}", "plot")
    if plot is not None:
        check_plot()
        check_free(plot, force=force)
    jobs = _codec_jobs(codecs, pairs, as_curve, poses, learn, metrics) + _peer_jobs(codecs, peers)
    check_finite(source, frames)
    unkept: Counter[str] = Counter()
    given = {"unkept": unkept, "frames": frames, "skip": skip, "calibration": calibration, "metrics": metrics}
    results: list[dict[str, Any]] = []
    done = 0
    with suppress(KeyboardInterrupt):
        for number, job in enumerate(jobs, 1):
            try:
                with progress(f"{job.name} ({number} of {len(jobs)})", frames) as tick:
                    results.append(job.measure(source, **given, tick=tick))
            except DecodeError as failed:
                if job.asked_for:
                    raise
                print(f"not measured: {failed}", file=sys.stderr)
            done = number
    say_unkept(source, unkept)
    part = done < len(jobs)
    end: list[dict[str, Any]] = [interrupted_after(done, len(jobs))] if part else []
    if as_json or results:
        tell(results + end, text_table(results) if results else "", as_json)
    if plot is not None and results:
        with whole(plot, force=force) as output:
            if part:
                output.only_part()
            drawn = plot_bits if not as_curve else plot_curves if metrics == "usual" else plot_operating
            drawn(results, output.beside)
    if part:
        raise StoppedError(f"stopped: the output has only {done} of {len(jobs)} settings")


def _codec_jobs(
    codecs: str | None, pairs: list[str], as_curve: bool, poses: Path | None, learn: int, metrics: str
) -> list[Job]:
    """The measurements of lidarcodec's own codecs: all names in `--codec` except peers."""
    own = codecs
    if codecs:
        own = ",".join(name for name in codecs.split(",") if not table.is_peer(name.strip()))
        if not own:
            if pairs:
                raise SettingsError(f"--set {pairs[0]}: peers have no settings, and --codec names only peers")
            return []
    if not as_curve:
        return _jobs(sweep(own, pairs), partial(bench, poses=poses, learn=learn))
    if metrics == "usual":
        return _jobs(curve(own, pairs), partial(bench, poses=poses, learn=learn))
    return _jobs(operating(own, pairs), partial(OperatingPoints(poses).bench, poses=poses, learn=learn))


def _jobs(settings: list[StreamSettings], measure: Callable[..., dict[str, Any]]) -> list[Job]:
    return [Job(chosen.codec, partial(measure, settings=chosen)) for chosen in settings]


def _peer_jobs(codecs: str | None, all_of_them: bool) -> list[Job]:
    """The measurements of named peers, or with `all_of_them` of every peer installed here; missing ones are reported.

    Raises UnknownNameError or MissingExtraError for a named peer that cannot run.
    """
    named = [name.strip() for name in (codecs or "").split(",") if table.is_peer(name.strip())]
    jobs: list[Job] = []
    for name in named + [name for name in table.names() if all_of_them and name not in named]:
        try:
            found = table.peer(name)
        except MissingExtraError as missing:
            if name in named:
                raise
            print(f"not measured: {missing}", file=sys.stderr)
            continue
        jobs += [Job(name, partial(bench_peer, name=name, value=value), name in named) for value in found.values]
    return jobs

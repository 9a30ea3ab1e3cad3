"""`lidarcodec evaluate localisation`: compares reductions and codecs by the accuracy of localisation with them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, TypeVar

from lidarcodec.commands.bench.curve import curve
from lidarcodec.commands.progress import progress
from lidarcodec.commands.running.stopping import StoppedError, interrupted_after
from lidarcodec.commands.running.telling import tell, terminal_width
from lidarcodec.commands.settings import sweep
from lidarcodec.commands.sources import check_finite
from lidarcodec.errors import SettingsError
from lidarcodec.evaluation.localisation.cache import Cache
from lidarcodec.evaluation.localisation.evaluate import MAPS, RECEIVERS, Evaluation, Options, Outcome
from lidarcodec.evaluation.localisation.icp import LOCALISERS
from lidarcodec.evaluation.localisation.methods import Method, methods
from lidarcodec.evaluation.localisation.plots import plot_boxes, plot_maps, plot_sweep
from lidarcodec.evaluation.localisation.protocol import PROTOCOLS
from lidarcodec.evaluation.localisation.reference import REFERENCES
from lidarcodec.evaluation.localisation.report import over_drives, text_tables
from lidarcodec.evaluation.localisation.sweep import against_original, crossings
from lidarcodec.evaluation.plots import check_plot
from lidarcodec.files.whole import check_free, whole
from lidarcodec.settings import StreamSettings

DEFAULT_CODEC: Final = "predictive"
DEFAULT_BOUND: Final = "max_error_m=0.01"
PICTURES: Final = re.compile(r"(sweep|errors|maps)-.*\.png")
"""Plots of `--plots`."""
MOST_POINTS: Final = 200_000
ORIGINAL: Final = Method("all", StreamSettings(codec="raw"))
Name = TypeVar("Name", bound=str)


@dataclass(frozen=True)
class Asked:
    """The options that select what to compare, and how."""

    sources: Sequence[str]
    reductions: Sequence[str]
    codecs: str | None
    pairs: Sequence[str]
    keep_points: str
    frame_bytes: int | None
    maps: Sequence[str]
    receivers: Sequence[str]
    localisers: Sequence[str]
    protocols: Sequence[str]
    stride: int
    reference: str
    sweep: bool
    seed: int

    def options(self) -> Options:
        """The checked options.

        Raises SettingsError for an unknown name.
        """
        usual = ("near",) if self.sweep else PROTOCOLS
        return Options(
            _known("--map", self.maps or MAPS[:1], MAPS),
            _known("--receiver", self.receivers or (RECEIVERS[1:] if self.sweep else RECEIVERS[:1]), RECEIVERS),
            _known("--localiser", self.localisers or list(LOCALISERS)[: 2 if self.sweep else 1], tuple(LOCALISERS)),
            _known("--protocol", self.protocols or usual, PROTOCOLS),
            _known("--reference", [self.reference], REFERENCES)[0],
            self.stride,
            self.seed,
        )

    def methods(self) -> list[Method]:
        """All methods to compare.

        Raises SettingsError, UnknownNameError.
        """
        given = {pair.partition("=")[0].strip() for pair in self.pairs}
        pairs = [*self.pairs, *(["intensity=off"] if "intensity" not in given else [])]
        bounded = self.codecs is None and "max_error_m" not in given and "target_kbps" not in given
        codecs = self.codecs or DEFAULT_CODEC
        chosen = curve(codecs, pairs) if self.sweep else sweep(codecs, [*pairs, DEFAULT_BOUND] if bounded else pairs)
        usual = ["all"] if self.sweep else ["all", "voxel"]
        reductions = [name.strip() for names in self.reductions for name in names.split(",")] or usual
        return methods(reductions, chosen, self._budgets(), self.frame_bytes)

    def _budgets(self) -> list[int]:
        try:
            budgets = [int(text) for text in self.keep_points.split(",")]
        except ValueError:
            raise SettingsError(
                f"--keep-points {self.keep_points}: write whole numbers with commas between them"
            ) from None
        if not all(1 <= budget <= MOST_POINTS for budget in budgets):
            raise SettingsError(f"--keep-points {self.keep_points}: each must be 1 to {MOST_POINTS}", "keep_points")
        return budgets


def run(
    asked: Asked,
    frames: int | None,
    skip: int,
    calibration: Path | None,
    poses: Path | None,
    cache: Path | None,
    plots: Path | None,
    as_json: bool,
    force: bool = False,
) -> None:
    """Measure every method on every source and print the results. If stopped, print the finished ones."""
    options, compared = asked.options(), asked.methods()
    for source in asked.sources:
        check_finite(source, frames)
    if poses is not None and len(asked.sources) > 1:
        raise SettingsError("--poses works with a single source only", "poses")
    if plots is not None:
        check_plot()
        check_free(plots, force=force, contents=PICTURES)
    outcomes: list[Outcome] = []
    done = 0
    with suppress(KeyboardInterrupt):
        for number, source in enumerate(asked.sources, 1):
            with progress(f"{source} ({number} of {len(asked.sources)})") as tick:
                evaluation = Evaluation(
                    source,
                    options,
                    Cache(cache),
                    frames=frames,
                    skip=skip,
                    calibration=calibration,
                    poses=poses,
                    tick=tick,
                )
                original = evaluation.method(ORIGINAL) if asked.sweep else []
                for method in compared:
                    found = evaluation.method(method)
                    for one, unreduced in zip(found, original, strict=False):
                        one.result["against_original"] = against_original(one, unreduced, asked.seed)
                    outcomes += found
                    done += 1
    wanted = len(asked.sources) * len(compared)
    _print(asked, outcomes, as_json, [] if done == wanted else [interrupted_after(done, wanted)])
    if plots is not None and outcomes:
        with whole(plots, force=force, contents=PICTURES) as output:
            if done < wanted:
                output.only_part()
            _draw(asked, options, outcomes, output.beside)
    if done < wanted:
        raise StoppedError(f"stopped: the output has only {done} of {wanted} methods")


def _print(asked: Asked, outcomes: Sequence[Outcome], as_json: bool, end: list[dict[str, bool | int]]) -> None:
    results: list[dict[str, Any]] = [outcome.result for outcome in outcomes]
    results += over_drives(outcomes, asked.seed)
    if not (as_json or results):
        return
    lines = [text_tables(results, terminal_width())] if results else []
    if asked.sweep and results:
        lines += ["", *_crossing_lines(asked, [outcome.result for outcome in outcomes])]
    tell(results + end, "\n".join(lines), as_json)


def _crossing_lines(asked: Asked, results: Sequence[dict[str, Any]]) -> list[str]:
    lines = []
    for protocol in asked.options().protocols:
        for one in crossings(results, protocol):
            at = one["at_5_cm"]
            text = (
                "not reached" if at is None else f"{'at most ' if at['is'] == 'below' else ''}{at['kbps']:,.0f} kbit/s"
            )
            lines.append(
                f"5 cm RMSE, {protocol}, {one['source']}, {one['codec']}, {one['receiver']}, {one['localiser']}: {text}"
            )
    return lines


def _draw(asked: Asked, options: Options, outcomes: Sequence[Outcome], plots: Path) -> None:
    for number, source in enumerate(dict.fromkeys(outcome.result["source"] for outcome in outcomes), 1):
        own = [outcome for outcome in outcomes if outcome.result["source"] == source]
        if asked.sweep:
            for protocol in options.protocols:
                plot_sweep([outcome.result for outcome in own], plots / f"sweep-{number}-{protocol}.png", protocol)
            continue
        for protocol in options.protocols:
            plot_boxes(own, plots / f"errors-{number}-{protocol}.png", protocol)
        first = {outcome.result["reduction"]: outcome for outcome in reversed(own)}
        plot_maps(list(reversed(first.values())), plots / f"maps-{number}.png")


def _known(option: str, names: Sequence[str], known: Sequence[Name]) -> list[Name]:
    for name in names:
        if name not in known:
            raise SettingsError(f"{option} must be {' or '.join(known)}, not '{name}'", option.lstrip("-"))
    return [value for name in names for value in known if value == name]

"""`lidarcodec bench`: codecs and settings side by side on one source."""

from __future__ import annotations

import json
from contextlib import suppress
from pathlib import Path

from lidarcodec.commands.progress import progress
from lidarcodec.commands.settings import sweep
from lidarcodec.commands.sources import check_finite
from lidarcodec.errors import SettingsError
from lidarcodec.evaluation.bench import bench
from lidarcodec.evaluation.report import check_plot, text_table
from lidarcodec.evaluation.report import plot as draw

PLOTS = (".png", ".svg", ".pdf")


def run(
    source: str,
    codecs: str | None,
    pairs: list[str],
    frames: int | None,
    skip: int,
    calibration: Path | None,
    poses: Path | None,
    plot: Path | None,
    as_json: bool,
) -> None:
    """Measure each setting and print the results; when stopped, those that were finished."""
    settings = sweep(codecs, pairs)
    if plot is not None and plot.suffix.lower() not in PLOTS:
        raise SettingsError(f"cannot draw {plot}: let it end in {' '.join(PLOTS)}", "plot")
    if plot is not None:
        check_plot()
    check_finite(source, frames)
    results = []
    with suppress(KeyboardInterrupt):
        for number, chosen in enumerate(settings, 1):
            with progress(f"{chosen.codec} ({number} of {len(settings)})", frames) as tick:
                results.append(
                    bench(source, chosen, frames=frames, skip=skip, calibration=calibration, poses=poses, tick=tick)
                )
    if as_json or results:
        print(json.dumps(results, indent=2) if as_json else text_table(results))
    if plot is not None and results:
        draw(results, plot)

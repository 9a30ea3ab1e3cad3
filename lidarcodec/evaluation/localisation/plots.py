"""Plots of localisation: box plots of errors (the paper's Fig. 6), maps from above (Fig. 5), error against bitrate."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from lidarcodec.evaluation.localisation.evaluate import Outcome
from lidarcodec.evaluation.localisation.report import codec_of, label
from lidarcodec.evaluation.localisation.sweep import AIM_M
from lidarcodec.evaluation.plots import MARKS, blank_figure, plain_ticks

DPI: Final = 80
DRAWN: Final = 60_000
"""Most points of a map that are drawn."""


def plot_boxes(outcomes: Sequence[Outcome], path: Path, protocol: str = "track") -> None:
    """A box for each method: quartiles, whiskers at 1.5 times the quartile distance, outliers as dots; logarithmic.

    Raises MissingExtraError without matplotlib, OSError if the file cannot be written.
    """
    figure = blank_figure(9, 1.6 + 0.32 * len(outcomes))
    names = [_name(outcome.result, outcomes) for outcome in outcomes]
    panels = figure.subplots(1, 2, sharey=True)
    for axes, field, text in zip(panels, ("trans_m", "rot"), ("translation, m", "rotation, |R - I|"), strict=True):
        values = [np.maximum(outcome.errors[protocol][field], 1e-6) for outcome in outcomes]
        axes.boxplot(values, orientation="horizontal", tick_labels=names, flierprops={"marker": ".", "markersize": 3})
        axes.set_xscale("log")
        axes.set_xlabel(text)
        axes.grid(axis="x", alpha=0.3)
    panels[0].invert_yaxis()
    figure.suptitle(f"{outcomes[0].result['source']}: absolute pose errors, {protocol}", fontsize=10)
    figure.savefig(path, dpi=DPI)


def plot_maps(outcomes: Sequence[Outcome], path: Path) -> None:
    """The map of each method from above, coloured by height. The title has the number of points and r_c."""
    shown = [outcome for outcome in outcomes if outcome.world is not None]
    figure = blank_figure(9, 0.5 + 1.5 * len(shown))
    for axes, outcome in zip(
        np.atleast_1d(figure.subplots(len(shown), 1, sharex=True, sharey=True)), shown, strict=True
    ):
        world = np.asarray(outcome.world)
        drawn = world[np.random.default_rng(1).permutation(len(world))[:DRAWN]]
        middle = np.median(world[:, 2])
        axes.scatter(
            drawn[:, 0],
            drawn[:, 1],
            c=np.clip(drawn[:, 2], middle - 2, middle + 4),
            s=0.15,
            cmap="viridis",
            rasterized=True,
        )
        axes.set_aspect("equal")
        result = outcome.result
        axes.set_title(f"{label(result)}: N {result['map_points']:,}, r_c {result['r_c'] * 100:.2f} %", fontsize=8)
        axes.tick_params(labelsize=6)
    figure.suptitle(f"{outcomes[0].result['source']}: maps of every fifth scan, metres", fontsize=9)
    figure.savefig(path, dpi=DPI)


def plot_sweep(results: Sequence[dict[str, Any]], path: Path, protocol: str) -> None:
    """Position RMSE against bitrate, a line for each codec, a panel for each localiser. Both axes are logarithmic, and
    5 cm is marked."""
    localisers = list(dict.fromkeys(result["localiser"] for result in results))
    figure = blank_figure(5.2 * len(localisers), 4.4)
    panels = np.atleast_1d(figure.subplots(1, len(localisers), sharey=True))
    for axes, localiser in zip(panels, localisers, strict=True):
        own = [result for result in results if result["localiser"] == localiser]
        for mark, codec in zip(MARKS * 3, dict.fromkeys(result["codec"] for result in own), strict=False):
            line = sorted(
                (one["kbps"], one["against_original"][protocol]["rmse_m"])
                for one in own
                if one["codec"] == codec and one["against_original"][protocol]["rmse_m"] is not None
            )
            kbps, rmse = np.array(line).reshape(-1, 2).T
            axes.plot(kbps, np.maximum(rmse, 1e-5), marker=mark, markersize=4, linewidth=1, label=codec)
        axes.axhline(AIM_M, color="#9ca3af", linestyle="--", linewidth=1)
        axes.set(xscale="log", yscale="log", xlabel="kbit/s, all data included", title=localiser)
        plain_ticks(axes.xaxis)
        axes.grid(alpha=0.3, which="both", linewidth=0.5)
    panels[0].set_ylabel("position RMSE relative to the original, m")
    panels[0].legend(frameon=False, fontsize=8)
    figure.suptitle(f"{results[0]['source']}, {results[0]['receiver']}", fontsize=10)
    figure.savefig(path, dpi=DPI)


def _name(result: dict[str, Any], outcomes: Sequence[Outcome]) -> str:
    """The method's name, with further options if they differ between methods."""
    parts = [label(result)]
    for key in ("map", "receiver", "localiser"):
        if len({outcome.result[key] for outcome in outcomes}) > 1:
            parts.append(result[key])
    if len({codec_of(outcome.result) for outcome in outcomes}) > 1:
        parts.append(codec_of(result))
    return ", ".join(parts)

"""Plots of operating curves: each measure against the bitrate."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final, NamedTuple

from lidarcodec.evaluation.plots import MARKS, blank_figure, plain_ticks
from lidarcodec.evaluation.report import Result

HZ: Final = 10


class Measure(NamedTuple):
    """title;  of: gives a result's value, None if it has none;  logarithmic: whether the scale is logarithmic"""

    title: str
    of: Callable[[Result], float | None]
    logarithmic: bool = False


def _filled(result: Result, name: str) -> float | None:
    value: float | None = (result.get("filled") or {}).get(name)
    return value


def _localisation(result: Result) -> float | None:
    found = result.get("localisation")
    return None if not found or found["mate_m"] is None else 1e3 * found["mate_m"]


def _fps(result: Result) -> float | None:
    left_out = result.get("frames_left_out")
    return None if left_out is None else HZ * (1.0 - left_out / result["frames"])


def _millimetres(value: float | None) -> float | None:
    return 1e3 * value if value else None


MEASURES: Final = (
    Measure(
        "Chamfer distance, mm, interpolated",
        lambda r: _millimetres(_filled(r, "chamfer_m")),
        logarithmic=True,
    ),
    Measure("D2, dB, interpolated", lambda r: _filled(r, "d2_psnr_db")),
    Measure("PSNR of intensity, dB", lambda r: r.get("intensity_psnr_db")),
    Measure("share of the returns that are sent", lambda r: r.get("kept_fraction")),
    Measure("frames a second", _fps),
    Measure("localisation error from near starts, mm", _localisation, logarithmic=True),
)


def plot_operating(results: Sequence[Result], path: Path) -> None:
    """Draw each measure against the sent bitrate, a line for each codec.

    Chamfer distance and D2 include interpolated returns. A measure without values is omitted.
    Raises MissingExtraError without matplotlib, OSError if the file cannot be written.
    """
    figure = blank_figure(13, 7.6)
    for axes, measure in zip(figure.subplots(2, 3).flat, MEASURES, strict=True):
        for number, name in enumerate(dict.fromkeys(result["codec"] for result in results)):
            of_it = sorted((r for r in results if r["codec"] == name), key=lambda r: r["kbps_at_10hz"])
            points = [(r["kbps_at_10hz"], value) for r in of_it if (value := measure.of(r)) is not None]
            if points:
                axes.plot(*zip(*points, strict=True), f"{MARKS[number % len(MARKS)]}-", label=name, markersize=4)
        axes.set_title(measure.title, fontsize=10)
        axes.set_xlabel("kbit/s at 10 Hz, all data included")
        axes.grid(alpha=0.3, which="both", linewidth=0.5)
        if not axes.lines:
            axes.text(0.5, 0.5, "not measured", ha="center", va="center", transform=axes.transAxes)
            continue
        axes.set_xscale("log")
        plain_ticks(axes.xaxis)
        if measure.logarithmic:
            axes.set_yscale("log")
            plain_ticks(axes.yaxis)
        else:
            axes.set_ylim(bottom=0)
    figure.axes[0].legend(frameon=False, fontsize=8)
    figure.suptitle(f"{results[0]['source']}, {results[0]['frames']} frames")
    figure.savefig(path, dpi=110)

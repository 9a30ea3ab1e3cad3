"""Plots of `bench` results: bits by plane, and error against bitrate."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from lidarcodec.errors import MissingExtraError
from lidarcodec.evaluation.report import Result, label

if TYPE_CHECKING:
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

PLANES = {
    "range": "#2563eb",
    "mask": "#0ea5e9",
    "intensity": "#f59e0b",
    "azimuth": "#a855f7",
    "side": "#64748b",
    "header": "#cbd5e1",
}
"""Parts of a message in stacking order, and their colours."""
UNSPLIT = "#9ca3af"
"""Colour of a peer's total, which has no parts."""
MARKS = "osD^vP*X<>ph"


def check_plot() -> None:
    """Raise MissingExtraError if plots cannot be drawn. Call it before long measurements."""
    if find_spec("matplotlib") is None:
        raise MissingExtraError("--plot", "plot")


def blank_figure(width: float, height: float) -> Figure:
    """An empty figure, size in inches, that needs no window.

    Raises MissingExtraError without matplotlib.
    """
    check_plot()
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _title(results: Sequence[Result]) -> str:
    return f"{Path(results[0]['source']).name}, {results[0]['frames']} frames"


def plain_ticks(*scales: Axis) -> None:
    """Label logarithmic scales only at 1, 2, 5, 10, ..."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    for scale in scales:
        scale.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        scale.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,g}"))
        scale.set_minor_formatter(NullFormatter())


def plot_bits(results: Sequence[Result], path: Path) -> None:
    """Draw bits per point by plane, and bits of geometry against error, into a file of any type of matplotlib.

    Raises MissingExtraError without matplotlib, OSError if the file cannot be written.
    """
    figure = blank_figure(12, 1.8 + 0.5 * len(results))
    names = [label(result) for result in results]
    bits = [result["bits_per_point"] for result in results]
    bars, curve = figure.subplots(1, 2, width_ratios=(3, 2))
    left = [0.0] * len(results)
    for plane, colour in PLANES.items():
        values = [part[plane] or 0.0 for part in bits]
        bars.barh(names, values, left=left, color=colour, label=plane)
        left = [a + b for a, b in zip(left, values, strict=True)]
    unsplit = [(part["total"] or 0.0) if part["range"] is None else 0.0 for part in bits]
    if any(unsplit):
        bars.barh(names, unsplit, color=UNSPLIT, label="not split")
    bars.invert_yaxis()
    bars.set_xlabel("bits per point, all data included")
    bars.legend(ncols=3, frameon=False, loc="lower center", bbox_to_anchor=(0.5, 1.0))  # "best" can take seconds
    for name, result, part in zip(names, results, bits, strict=True):
        if part["geometry"] is not None:
            curve.plot((result["rmse_m"] or 0.0) * 1e3, part["geometry"], "o", label=name)
    curve.set_xlabel("RMSE along the ray, mm")
    curve.set_ylabel("bits per point, range and mask")
    curve.set_ylim(bottom=0)
    curve.grid(alpha=0.3)
    figure.suptitle(f"{results[0]['source']}, {results[0]['frames']} frames")
    figure.savefig(path, dpi=150)


def plot_curves(results: Sequence[Result], path: Path, *, title: str | None = None, dpi: int = 110) -> None:
    """Draw RMSE and PSNR against kbit/s, with bits per point as a second scale, a line for each codec.

    All bits count. A logarithmic scale has no zero, so results without an error are drawn at its lower end.

    Raises MissingExtraError without matplotlib, OSError if the file cannot be written.
    """
    figure = blank_figure(11, 4.6)
    rmse, psnr = figure.subplots(1, 2)
    lossy = [1e3 * r["rmse_m"] for r in results if r["rmse_m"]]
    floor_mm = 0.5 * min(lossy, default=1.0)
    for number, name in enumerate(dict.fromkeys(result["codec"] for result in results)):
        of_it = sorted((r for r in results if r["codec"] == name), key=lambda r: r["kbps_at_10hz"])
        style = f"{MARKS[number % len(MARKS)]}{':' if ':' in name else '-'}"
        points = [(r["kbps_at_10hz"], 1e3 * r["rmse_m"] or floor_mm) for r in of_it if r["rmse_m"] is not None]
        if points:  # a source without returns has no points
            rmse.plot(*zip(*points, strict=True), style, label=name, markersize=4, linewidth=1.2)
        heights = [(r["kbps_at_10hz"], r["psnr_db"]) for r in of_it if r["psnr_db"] is not None]
        if heights:
            psnr.plot(*zip(*heights, strict=True), style, label=name, markersize=4, linewidth=1.2)
    rmse.set_yscale("log")
    plain_ticks(rmse.yaxis)
    rmse.set_ylabel(f"RMSE along the ray, mm (lossless: drawn at {floor_mm:.2g})")
    psnr.set_ylabel("PSNR over 130 m, dB")
    kbps_per_bit = max(results[0]["kbps_at_10hz"] / (results[0]["bits_per_point"]["total"] or 1.0), 1e-9)
    for axes in (rmse, psnr):
        axes.set_xscale("log")
        axes.set_xlabel("kbit/s at 10 Hz, all data included")
        above = axes.secondary_xaxis("top", functions=(lambda x: x / kbps_per_bit, lambda x: x * kbps_per_bit))
        above.set_xlabel("bits per point")
        plain_ticks(axes.xaxis, above.xaxis)
        axes.grid(alpha=0.3, which="both", linewidth=0.5)
    if rmse.lines:
        rmse.legend(frameon=False, fontsize=8, loc="upper right")
    figure.suptitle(title or _title(results))
    figure.savefig(path, dpi=dpi)

"""Results of `bench` as a table to read and a picture to look at."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from lidarcodec.errors import MissingExtraError
from lidarcodec.evaluation.bench import effective
from lidarcodec.settings import StreamSettings

Result = dict[str, Any]

PLANES = {
    "range": "#2563eb",
    "mask": "#0ea5e9",
    "intensity": "#f59e0b",
    "azimuth": "#a855f7",
    "side": "#64748b",
    "header": "#cbd5e1",
}
"""Parts of a message in the order in which they are stacked, and their colours."""


def _number(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:,.{digits}f}"


def label(result: Result) -> str:
    """The codec and what was set apart from the defaults, for one line of a table."""
    defaults = effective(StreamSettings(codec=result["codec"]))
    own_defaults = defaults.pop("codec_settings")
    settings = dict(result["settings"])
    own = settings.pop("codec_settings")
    apart = {key: value for key, value in settings.items() if value != defaults[key]}
    apart |= {key: value for key, value in own.items() if value != own_defaults[key]}
    return " ".join([result["codec"], *(f"{key}={value}" for key, value in apart.items())])


COLUMNS: dict[str, Callable[[Result], str]] = {
    "codec": label,
    "range": lambda r: _number(r["bits_per_point"]["range"], 2),
    "mask": lambda r: _number(r["bits_per_point"]["mask"], 2),
    "geometry": lambda r: _number(r["bits_per_point"]["geometry"], 2),
    "intensity": lambda r: _number(r["bits_per_point"]["intensity"], 2),
    "azimuth": lambda r: _number(r["bits_per_point"]["azimuth"], 2),
    "side": lambda r: _number(r["bits_per_point"]["side"], 2),
    "header": lambda r: _number(r["bits_per_point"]["header"], 3),
    "total": lambda r: _number(r["bits_per_point"]["total"], 2),
    "ratio": lambda r: _number(r["ratio"], 2),
    "kbit/s": lambda r: _number(r["kbps_at_10hz"], 0),
    "rmse mm": lambda r: _number(None if r["rmse_m"] is None else r["rmse_m"] * 1e3, 2),
    "max mm": lambda r: _number(None if r["max_error_m"] is None else r["max_error_m"] * 1e3, 0),
    "packets": lambda r: "identical" if r["packets_identical"] else "differ",
    "encode ms": lambda r: _number(r["encode_ms"]["p50"], 1),
    "decode ms": lambda r: _number(r["decode_ms"]["p50"], 1),
}


def text_table(results: Sequence[Result]) -> str:
    """A line for each result, bits per point split by plane, and what was measured above it."""
    first = results[0]
    calibration = first["calibration"]
    head = (
        f"{first['source']}: {first['frames']} frames, {first['points_per_frame']:,.0f} points a frame, "
        f"calibration {calibration['origin']} {calibration['hash']}; bits per point"
    )
    rows = [list(COLUMNS), *([cell(result) for cell in COLUMNS.values()] for result in results)]
    columns = []
    for at, cells in enumerate(zip(*rows, strict=True)):
        width = max(map(len, cells))
        columns.append([cell.ljust(width) if at == 0 else cell.rjust(width) for cell in cells])
    return "\n".join([head, *("  ".join(row) for row in zip(*columns, strict=True))])


def check_plot() -> None:
    """Raise MissingExtraError if nothing can be drawn here; looked at before hours are spent on measuring."""
    if find_spec("matplotlib") is None:
        raise MissingExtraError("--plot", "plot")


def plot(results: Sequence[Result], path: Path) -> None:
    """Draw bits per point by plane, and geometry against error, into a file of any type that matplotlib writes.

    Raises MissingExtraError without matplotlib, OSError when the file cannot be written.
    """
    check_plot()
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    names = [label(result) for result in results]
    bits = [result["bits_per_point"] for result in results]
    figure = Figure(figsize=(12, 1.8 + 0.5 * len(results)), layout="constrained")
    FigureCanvasAgg(figure)
    bars, curve = figure.subplots(1, 2, width_ratios=(3, 2))
    left = [0.0] * len(results)
    for plane, colour in PLANES.items():
        values = [part[plane] or 0.0 for part in bits]
        bars.barh(names, values, left=left, color=colour, label=plane)
        left = [a + b for a, b in zip(left, values, strict=True)]
    bars.invert_yaxis()
    bars.set_xlabel("bits per point, everything counted")
    bars.legend(ncols=3, frameon=False)
    for name, result, part in zip(names, results, bits, strict=True):
        curve.plot((result["rmse_m"] or 0.0) * 1e3, part["geometry"] or 0.0, "o", label=name)
    curve.set_xlabel("RMSE along the ray, mm")
    curve.set_ylabel("bits per point, range and mask")
    curve.set_ylim(bottom=0)
    curve.grid(alpha=0.3)
    figure.suptitle(f"{results[0]['source']}, {results[0]['frames']} frames")
    figure.savefig(path, dpi=150)

"""Learning curves of the papers' networks: kept as results, and drawn.

    python -m benchmarks.learning --keep poconet FILE.curve.csv --trained "lidarcodec train poconet ..."
    python -m benchmarks.learning --keep riddle DIR/curve.csv --trained "python -m research.riddle_paper train ..."
    python -m benchmarks.learning --keep riddle-temporal DIR/curve.csv --trained "... --temporal 100"
    python -m benchmarks.learning          draws docs/learning.png of what is kept

PocoNet's drives stand in poconet_drives.txt. `--keep` takes the curve that the training wrote, and its command, into
benchmarks/results/training/. Everything is drawn over the processor time of the training, measurements included.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from benchmarks import results
from lidarcodec.evaluation.plots import blank_figure

PICTURE: Final = Path(__file__).resolve().parents[1] / "docs" / "learning.png"
TIME: Final = "processor_minutes"
TITLES: Final = {
    "poconet": "PocoNet while it learns, on simulated drives that it does not learn from",
    "riddle": "RIDDLE's own predictor (intra) while it learns, on KITTI 0005",
    "riddle-temporal": "RIDDLE's own predictor (temporal) while it learns, on KITTI 0005",
}
COLOURS: Final = ("#2563eb", "#dc2626", "#16a34a", "#f59e0b")
Points = list[tuple[float, float]]


def keep(network: str, curve: Path, trained: str, about: str) -> None:
    """Make a result of a curve."""
    table = results.parse(curve.read_text())
    fields = results.here() | {"title": TITLES[network], "about": about, "command": trained}
    results.write(f"training/{network}", results.Result(fields, table.columns, table.rows))


def lines(network: str, column: str, *by: str) -> dict[str, Points]:
    """Points (processor minutes, value) of a column, a line for each value of the columns `by`."""
    result = results.read(f"training/{network}")
    found: dict[str, Points] = {}
    for cells in result.rows:
        row = dict(zip(result.columns, cells, strict=True))
        if row[column]:
            name = " ".join(row[part] for part in by)
            found.setdefault(name, []).append((float(row[TIME]), float(row[column])))
    return {name: sorted(set(points)) for name, points in found.items()}


def draw() -> None:
    """Losses above, below what was reached on other drives."""
    figure = blank_figure(11, 7)
    (loss, bits_loss), (precision, bits) = figure.subplots(2, 2)
    _panel(loss, "PocoNet: loss of the labels", lines("poconet", "label_loss"))
    _panel(bits_loss, "RIDDLE, intra: loss", lines("riddle", "loss"))
    _panel(precision, "PocoNet: precision", lines("poconet", "precision", "drive"))
    learned = {
        f"learned, steps of {name} m": points for name, points in lines("riddle", "entropy_bits", "step_m").items()
    }
    plain = lines("riddle", "previous_valid_entropy_bits", "step_m")
    _panel(bits, "RIDDLE, intra: bits a return (entropy)", learned)
    for colour, (name, points) in zip(COLOURS, plain.items(), strict=False):
        label = f"previous valid, steps of {name} m"
        bits.plot(*zip(*points, strict=True), linestyle="--", color=colour, linewidth=1, label=label)
    for axes in (precision, bits):
        axes.legend(frameon=False, fontsize=7)
    figure.savefig(PICTURE, dpi=80)


def _panel(axes: Any, title: str, drawn: dict[str, Points]) -> None:
    for colour, (name, points) in zip(COLOURS, drawn.items(), strict=False):
        axes.plot(*zip(*points, strict=True), marker=".", color=colour, label=name)
    axes.set_title(title, fontsize=9)
    axes.set_xlabel("minutes of one core", fontsize=8)
    axes.grid(alpha=0.3, linewidth=0.5)


def main(given: Sequence[str] | None = None) -> None:
    """Command line."""
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    words.add_argument("--keep", nargs=2, metavar=("NETWORK", "FILE"), help=f"{', '.join(TITLES)}: and its curve")
    words.add_argument("--trained", default="", metavar="COMMAND", help="of the training")
    words.add_argument("--about", default="", metavar="TEXT", help="what it learned from")
    asked = words.parse_args(given)
    if asked.keep:
        keep(asked.keep[0], Path(asked.keep[1]), asked.trained, asked.about)
    else:
        draw()


if __name__ == "__main__":
    main()

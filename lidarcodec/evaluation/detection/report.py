"""Results of `evaluate detection` as a text table."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from lidarcodec.evaluation.report import aligned, number
from lidarcodec.evaluation.report import label as codec_label

Result = dict[str, Any]
EXPLAINED = """\
found = labelled objects that are one cluster, with an intersection over union above 0.5; d found = percentage points
more than in the original frames, +- one standard error by bootstrap over objects; returns = left in the boxes; size =
mean error of a cluster's length, width and height; d size = how much larger it is than in the original frames; ground =
intersection over union of the returns on the ground with those of the original frames; AP = average precision of the
detector, in percent; d AP = percentage points more than in the original frames"""


def text_tables(results: Sequence[Result], width: int | None = None) -> str:
    """A table for each drive, with an explanation of the columns above. width: of the tables, as of `aligned`"""
    lines = [EXPLAINED]
    for source in dict.fromkeys(result["source"] for result in results):
        rows = [_cells(result) for result in results if result["source"] == source]
        names = list(dict.fromkeys(name for row in rows for name in row))
        lines += ["", _head(next(result for result in results if result["source"] == source))]
        lines += aligned([names, *([row.get(name, "-") for name in names] for row in rows)], width)
    return "\n".join(lines)


def _head(result: Result) -> str:
    return (
        f"{result['source']}: {result['frames']} frames, {result['objects']} boxes of {result['tracks']} objects "
        f"with at least {result['fewest_returns']} returns ({result['labels']})"
    )


def name_of(result: Result) -> str:
    """The codec and its settings that are not defaults; for a recording its path."""
    if result.get("recording"):
        return str(result["recording"])
    return "original" if result["codec"] == "original" else codec_label(result)


def percent(share: float | None) -> str:
    """A share for a table, or a dash."""
    return number(None if share is None else 100 * share, 1)


def difference(score: Result, name: str, factor: float) -> str:
    """A difference from the original with its error, or a dash. factor: of the unit"""
    apart, error = score[f"{name}_difference"], score[f"{name}_difference_error"]
    if apart is None or score.get("codec") == "original":
        return "-"
    return f"{factor * apart:+.1f}" + ("" if error is None else f" +- {factor * error:.1f}")


def _cells(result: Result) -> dict[str, str]:
    cells = {
        "setting": name_of(result),
        "kbit/s": number(result["kbps"], 0),
        "points": number(result["points_per_frame"], 0),
        "left out": str(result["frames_left_out"]),
        "found %": percent(result["found"]),
        "d found": difference(result, "found", 100),
        "returns %": percent(result["returns"]),
        "size mm": number(None if result["size_error_m"] is None else 1000 * result["size_error_m"], 0),
        "d size": difference(result, "size_error", 1000),
        "ground %": percent(result["ground_iou"]),
    }
    for kind, score in result["kinds"].items():
        cells[f"{kind} %"] = percent(score["found"])
    for band, score in result["distances"].items():
        cells[f"{band} m %"] = percent(score["found"])
    for kind, score in result.get("detector", {}).items():
        cells[f"{kind} AP"] = percent(score["ap"])
        cells[f"{kind} d AP"] = "-" if result["codec"] == "original" else difference(score, "ap", 100)
    return cells

"""Results as tables: a line for each method; for several drives also their means."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from lidarcodec.evaluation.localisation.errors import error_over_drives
from lidarcodec.evaluation.localisation.evaluate import Outcome
from lidarcodec.evaluation.localisation.protocol import PROTOCOLS, counted_errors
from lidarcodec.evaluation.report import aligned, number
from lidarcodec.evaluation.report import label as codec_label

Result = dict[str, Any]
SAME = ("reduction", "keep_points", "codec", "map", "receiver", "localiser")
"""Fields that must be equal in results of several drives to combine them, besides the codec's settings."""


def over_drives(outcomes: Sequence[Outcome], seed: int) -> list[Result]:
    """For each method that ran on several drives: means of the drives' means, their standard error, and sums of the
    failures."""
    groups: dict[str, list[Outcome]] = {}
    for outcome in outcomes:
        groups.setdefault(_key(outcome.result), []).append(outcome)
    return [_together(group, seed) for group in groups.values() if len(group) > 1]


def _key(result: Result) -> str:
    own = {name: value for name, value in result["settings"].items() if name != "keep_points"}
    return str([result[name] for name in SAME if name != "keep_points"]) + str(sorted(own.items(), key=str))


def _together(group: Sequence[Outcome], seed: int) -> Result:
    first = group[0].result
    mean: Result = {name: first[name] for name in (*SAME, "settings")}
    mean["source"] = f"{len(group)} drives"
    mean["sources"] = [outcome.result["source"] for outcome in group]
    for name in ("points_per_frame", "bytes_per_frame", "kbps", "map_points", "r_c"):
        mean[name] = float(np.mean([outcome.result[name] for outcome in group]))
    for protocol in PROTOCOLS:
        if protocol in first:
            mean[protocol] = _one_protocol(protocol, group, seed)
    return mean


def _one_protocol(protocol: str, group: Sequence[Outcome], seed: int) -> Result:
    parts = [outcome.result[protocol] for outcome in group]
    counted = [counted_errors(protocol, outcome.errors[protocol]) for outcome in group]
    held = [part for part, values in zip(parts, counted, strict=True) if len(values)]
    mean: Result = {"of": sum(part["of"] for part in parts)}
    for name in ("mate_m", "rot_mape", "mape", "angle_deg"):
        mean[name] = float(np.mean([part[name] for part in held])) if held else None
    mean["mate_m_error"] = error_over_drives([values for values in counted if len(values)], seed)
    for name in ("lost", "bad"):
        if name in parts[0]:
            mean[name] = sum(part[name] for part in parts)
    if "found" in parts[0]:
        shares = [part["found"] for part in parts if part["of"]]  # a short drive has no bad starts
        mean["found"] = float(np.mean(shares)) if shares else None
    return mean


def text_tables(results: Sequence[Result], width: int | None = None) -> str:
    """A table for each drive, with an explanation of the columns above. width: of the tables, as of `aligned`"""
    lines = [
        "Trans mATE in mm +- one standard error by bootstrap (over frames; over drives if there are several), without",
        "failed steps; Rot mAPE and mAPE as in evo; r_c = points of a map of the decoded frames, as a share of the",
        "returns that were used for it (N points); lost = steps of tracking that ended more than 1 m or 4 degrees off;",
        "found = share of searches from 2 m and 5 degrees off that ended at the place; near = searches from 0.5 m and",
        "1 degree off; bad = steps or searches that ended too far off to count in the mean",
    ]
    for source in dict.fromkeys(result["source"] for result in results):
        rows = [result for result in results if result["source"] == source]
        cells = [list(_cells(rows[0])), *(list(_cells(row).values()) for row in rows)]
        lines += ["", _head(rows[0]), *aligned(cells, width)]
    return "\n".join(lines)


def _head(result: Result) -> str:
    if "reference" not in result:
        return f"{result['source']}: {', '.join(result['sources'])}"
    known = result["reference"]
    noise = ""
    if known["noise_m"] is not None:
        noise = f", uncertain by {known['noise_m'] * 1000:.1f} mm and {known['noise_deg']:.3f} degrees"
    if known["slide_m"] is not None:
        slide = " / ".join(f"{metres * 1000:.0f}" for metres in known["slide_m"])
        noise += f"; over 0.8 s {slide} mm forward, left, up"
    return f"{result['source']}: {result['frames']} frames, {result['metres']} m, reference {known['kind']}{noise}"


def label(result: Result) -> str:
    """Name of a method: its reduction and its budget."""
    budget = result["keep_points"]
    return str(result["reduction"]) if budget is None else f"{result['reduction']} {budget:,}"


def _cells(result: Result) -> dict[str, str]:
    cells = {
        "method": label(result),
        "codec": codec_of(result),
        "map": result["map"],
        "receiver": result["receiver"],
        "by": result["localiser"],
        "points": number(result["points_per_frame"], 0),
        "kB": number(result["bytes_per_frame"] / 1000, 2),
        "kbit/s": number(result["kbps"], 0),
        "N": number(result["map_points"], 0),
        "r_c %": number(result["r_c"] * 100, 2),
    }
    for protocol in PROTOCOLS:
        if protocol in result:
            cells |= _judged(protocol, result[protocol])
    return cells


def _judged(protocol: str, part: Result) -> dict[str, str]:
    if protocol == "starts":
        return {"found": f"{number(part['found'], 2)} of {part['of']}", "found mm": _millimetres(part)}
    cells = {f"{protocol} mm": _millimetres(part)}
    if protocol == "track":
        cells |= {
            "Rot": number(part["rot_mape"], 5),
            "degrees": number(part["angle_deg"], 4),
            "mAPE": number(part["mape"], 4),
            "lost": f"{part['lost']} of {part['of']}",
        }
    return cells | {f"{protocol} bad": str(part["bad"])}


def _millimetres(part: Result) -> str:
    if part["mate_m"] is None:
        return "-"
    error = "" if part["mate_m_error"] is None else f" +- {part['mate_m_error'] * 1000:.1f}"
    return f"{part['mate_m'] * 1000:.1f}{error}"


def codec_of(result: Result) -> str:
    """The codec, and its settings that are not defaults."""
    return codec_label({**result, "settings": {**result["settings"], "reduction": "all", "keep_points": None}})

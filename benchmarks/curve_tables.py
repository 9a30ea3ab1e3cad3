"""The curves of benchmarks/results/curves.json as Markdown tables at equal RMSE, and as pictures."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from lidarcodec.evaluation.peers.table import NO_PACKAGE
from lidarcodec.evaluation.plots import plot_curves

AT_CM = (1.0, 2.0, 2.8, 5.0, 10.0, 20.0, 30.0, 50.0)
PICTURED = ("0005", "0013", "sfnd", "city")
Result = dict[str, Any]


def points_of(results: list[Result], codec: str) -> list[tuple[float, float, float]]:
    """(RMSE in m, bits per point of range and mask, kbit/s), by RMSE, of a codec's results that have an error."""
    return sorted(
        (r["rmse_m"], r["bits_per_point"]["geometry"], r["kbps_at_10hz"])
        for r in results
        if r["codec"] == codec and r["rmse_m"]
    )


def at_rmse(results: list[Result], codec: str, rmse_m: float) -> tuple[float, float] | None:
    """(bits per point of range and mask, kbit/s) at an RMSE: straight lines between results, on logarithmic scales.

    None where the codec has no results on both sides.
    """
    points = points_of(results, codec)
    if not points or not points[0][0] <= rmse_m <= points[-1][0]:
        return None
    rmse, bits, kbps = (np.log([point[at] for point in points]) for at in range(3))
    place = math.log(rmse_m)
    return math.exp(np.interp(place, rmse, bits)), math.exp(np.interp(place, rmse, kbps))


def _codecs(results: list[Result]) -> list[str]:
    return list(dict.fromkeys(result["codec"] for result in results))


def _row(cells: list[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _curve_table(scene: dict[str, Any]) -> Iterator[str]:
    results = scene["results"]
    yield _row(["bits a point at an RMSE of", *(f"{cm:g} cm" for cm in AT_CM), "lossless"])
    yield "|---|" + "---:|" * (len(AT_CM) + 1)
    best = {cm: min((found[0] for codec in _codecs(results) if (found := at_rmse(results, codec, cm / 100))), default=0)
            for cm in AT_CM}  # fmt: skip
    for codec in _codecs(results):
        cells = []
        for cm in AT_CM:
            found = at_rmse(results, codec, cm / 100)
            shown = "-" if found is None else f"{found[0]:.2f}"
            cells.append(f"**{shown}**" if found and found[0] == best[cm] else shown)
        exact = [r["bits_per_point"]["geometry"] for r in results if r["codec"] == codec and r["rmse_m"] == 0]
        yield _row([f"`{codec}`", *cells, f"{exact[0]:.2f}" if exact else "-"])
    yield _row(["kbit/s a bit", *[""] * len(AT_CM), f"{_kbps_per_bit(scene):,.0f}"])


def _kbps_per_bit(scene: dict[str, Any]) -> float:
    first = scene["results"][0]
    return float(first["kbps_at_10hz"] / first["bits_per_point"]["total"])


def _layers_table(known: dict[str, Any]) -> Iterator[str]:
    yield _row(["drive", "the car", *(f"{cm:g} cm" for cm in AT_CM)])
    yield "|---|---|" + "---:|" * len(AT_CM)
    for scene in known.values():
        cells = []
        for cm in AT_CM:
            one, layered = (at_rmse(scene["results"], codec, cm / 100) for codec in ("jpeg", "jpeg-layered"))
            cells.append(f"{100 * (layered[0] / one[0] - 1):+.0f} %" if one and layered else "-")
        yield _row([scene["title"], scene["about"].partition(";")[0], *cells])


def _peer_table(scenes: list[dict[str, Any]]) -> Iterator[str]:
    """A line for each coder, what it reached on each of the scenes with strokes between."""
    yield _row(["coder", "geometry", "all it holds", "RMSE mm", "max mm", "Chamfer mm", "plane dB", "D1 dB", "D2 dB"])
    yield "|---|" + "---:|" * 8
    for of_one in zip(*([*scene["ours"], *scene["peers"]] for scene in scenes), strict=True):
        columns = [_peer_cells(result) for result in of_one]
        cells = [both[0] if len(set(both)) == 1 else " / ".join(both) for both in zip(*columns, strict=True)]
        yield _row([f"`{_label(of_one[0])}`", *cells])


def _peer_cells(r: Result) -> list[str]:
    geometry = r["bits_per_point"]["geometry"]
    decibels = [r[f"{name}_db"] for name in ("point_to_plane_psnr", "d1_psnr", "d2_psnr")]
    return [
        "-" if geometry is None else f"{geometry:.2f}",
        f"{r['bits_per_point']['total']:.2f}",
        f"{1e3 * r['rmse_m']:.1f}",
        f"{1e3 * r['max_error_m']:.0f}",
        f"{1e3 * r['chamfer_m']:.1f}",
        *("-" if value is None else f"{value:.1f}" for value in decibels),
    ]


def _range_table(scene: dict[str, Any]) -> Iterator[str]:
    results = scene["by_range"]
    bands = [f"{band['from_m']:g}-{band['to_m']:.0f} m" for band in results[0]["range_errors"]]
    yield _row(["codec", "RMSE", "bits", *bands])
    yield "|---|---:|---:|" + "---:|" * len(bands)
    for r in results:
        shares = [[band[name] for name in ("p50_m", "p99_m", "max_m")] for band in r["range_errors"]]
        cells = ["-" if share[0] is None else " / ".join(f"{100 * value:.0f}" for value in share) for share in shares]
        yield _row([f"`{_label(r)}`", f"{100 * r['rmse_m']:.1f}", f"{r['bits_per_point']['geometry']:.2f}", *cells])


def _label(result: Result) -> str:
    return " ".join([result["codec"], *(f"{name}={value:g}" for name, value in result["knob"].items())])


def text(known: dict[str, Any]) -> str:
    """All tables, with their pictures."""
    parts = []
    for name, scene in known.items():
        which = f"`{scene['source']}`, frames {scene['skip']} to {scene['skip'] + scene['frames'] - 1}"
        lines = [f"#### {_title(scene)}", f"\n{which}, {scene['points_per_frame']:,.0f} points a frame.\n"]
        if name in PICTURED:
            lines.append(f"![RMSE and PSNR against bitrate, {scene['title']}]({_picture(name)})\n")
        parts.append("\n".join([*lines, *_curve_table(scene)]))
    parts.append("\n".join([
        "#### jpeg-layered against jpeg\n", "Bits of `jpeg-layered` more or less than `jpeg`'s at equal RMSE.\n",
        *_layers_table(known)]))  # fmt: skip
    with_peers = [scene for scene in known.values() if scene["peers"]]
    for scene in with_peers:
        head = f"#### Errors by range on {scene['title']}\n"
        parts.append("\n".join([head, "Median / 99th percentile / largest error, cm.\n", *_range_table(scene)]))
    versions = {word for scene in with_peers for r in scene["peers"] for word in r["version"].split(", ")} - {
        NO_PACKAGE
    }
    which = " / ".join(f"{scene['title']}, four frames from frame {scene['skip']}" for scene in with_peers)
    head = f"#### What peers reach\n\n{which}. {', '.join(sorted(versions))}.\n"
    parts.append("\n".join([head, *_peer_table(with_peers)]))
    return "\n\n".join(parts)


def _title(scene: dict[str, Any]) -> str:
    return f"{scene['title']}: the car {scene['about']}"


def _picture(name: str) -> str:
    return f"curves-{name}.png"


def draw(known: dict[str, Any], folder: Path) -> None:
    """The pictures of the page into a folder, in 48 colours: a third of the bytes."""
    from PIL import Image

    for name in PICTURED:
        if name in known:
            scene = known[name]
            path = folder / _picture(name)
            plot_curves(scene["results"], path, title=_title(scene), dpi=80)
            with Image.open(path) as picture:
                small = picture.convert("RGB").quantize(48)
            small.save(path, optimize=True)

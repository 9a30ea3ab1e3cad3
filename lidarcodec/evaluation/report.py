"""Results of `bench` as a text table."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from lidarcodec.evaluation.bench import effective
from lidarcodec.evaluation.peers.table import is_peer
from lidarcodec.settings import AUTO, StreamSettings

Result = dict[str, Any]


def number(value: float | None, digits: int) -> str:
    """A number for a table, or a dash."""
    return "-" if value is None else f"{value:,.{digits}f}"


def _mm(metres: float | None, digits: int) -> str:
    return number(None if metres is None else 1e3 * metres, digits)


def label(result: Result) -> str:
    """The codec and its settings that are not defaults, for one line of a table; for a peer all its settings."""
    if is_peer(result["codec"]):
        return " ".join([result["codec"], *(f"{k}={v}" for k, v in result["settings"].items() if k != "holds")])
    defaults = effective(StreamSettings(codec=result["codec"]))
    own_defaults = defaults.pop("codec_settings")
    settings = dict(result["settings"])
    own = settings.pop("codec_settings")
    apart = {key: value for key, value in settings.items() if value != defaults[key]}
    apart |= {key: value for key, value in own.items() if value != own_defaults[key]}
    return " ".join([result["codec"], *(f"{key}={_plain(value)}" for key, value in apart.items())])


def _plain(value: Any) -> Any:
    """A value as it is typed: 500 for 500.0."""
    return int(value) if isinstance(value, float) and value.is_integer() else value


def packets_word(identical: bool | None) -> str:
    """Text for whether packets are identical; a dash if the result has no packets."""
    return "-" if identical is None else "identical" if identical else "differ"


def _more_columns() -> dict[str, Callable[[Result], str]]:
    return {
        "chamfer mm": lambda r: _mm(r["chamfer_m"], 2),
        "filled mm": lambda r: _mm(r["filled"]["chamfer_m"], 2),
        "plane dB": lambda r: number(r["point_to_plane_psnr_db"], 2),
        "D1 dB": lambda r: number(r["d1_psnr_db"], 2),
        "D2 dB": lambda r: number(r["d2_psnr_db"], 2),
    }


def _reduced_columns() -> dict[str, Callable[[Result], str]]:
    return {
        "kept": lambda r: number(None if r["kept_fraction"] is None else r["kept_fraction"] * r["points_per_frame"], 0),
        "bit/kept": lambda r: number(r["bits_per_kept_point"], 2),
        "kB/frame": lambda r: number(r.get("kb_per_frame"), 2),
    }


COLUMNS: dict[str, Callable[[Result], str]] = {
    "codec": label,
    "range": lambda r: number(r["bits_per_point"]["range"], 2),
    "mask": lambda r: number(r["bits_per_point"]["mask"], 2),
    "geometry": lambda r: number(r["bits_per_point"]["geometry"], 2),
    "intensity": lambda r: number(r["bits_per_point"]["intensity"], 2),
    "azimuth": lambda r: number(r["bits_per_point"]["azimuth"], 2),
    "side": lambda r: number(r["bits_per_point"]["side"], 2),
    "images": lambda r: number(r["bits_per_point"].get("planes"), 2),
    "header": lambda r: number(r["bits_per_point"]["header"], 3),
    "total": lambda r: number(r["bits_per_point"]["total"], 2),
    "ratio": lambda r: number(r["ratio"], 2),
    "kbit/s": lambda r: number(r["kbps_at_10hz"], 0),
    "rmse mm": lambda r: _mm(r["rmse_m"], 2),
    "max mm": lambda r: _mm(r["max_error_m"], 0),
    "packets": lambda r: packets_word(r["packets_identical"]),
    "encode ms": lambda r: number(r["encode_ms"]["p50"], 1),
    "decode ms": lambda r: number(r["decode_ms"]["p50"], 1),
}


def text_table(results: Sequence[Result]) -> str:
    """A line for each result with bits per point by plane, below a heading that names the source."""
    first = results[0]
    calibration = first["calibration"]
    head = (
        f"{first['source']}: {first['frames']} frames, {first['points_per_frame']:,.0f} points a frame, "
        f"calibration {calibration['origin']} {calibration['hash']}; bits per point"
    )
    if (zstd := first.get("zstd_bits_per_point")) is not None:
        head += f" (zstd -3 of the messages: {number(zstd, 2)})"
    reduced = any(result["settings"].get("reduction", AUTO) not in (AUTO, "all") for result in results)
    shown = COLUMNS | (_reduced_columns() if reduced else {}) | (_more_columns() if "chamfer_m" in first else {})
    if not any("planes" in result["bits_per_point"] for result in results):
        shown = {name: cell for name, cell in shown.items() if name != "images"}
    rows = [list(shown), *([cell(result) for cell in shown.values()] for result in results)]
    return "\n".join([head, *aligned(rows)])


def aligned(rows: Sequence[Sequence[str]], width: int | None = None) -> list[str]:
    """Lines of a table. The first row is the head. The first column is left-aligned, the others are right-aligned.

    width: most characters in a line; None for no limit. Columns that do not fit follow in further tables. Each of them
           begins with the first column

    >>> aligned([["a", "one", "two"], ["b", "1", "2"]], 6)
    ['a  one', 'b    1', '', 'a  two', 'b    2']
    """
    columns = []
    for at, cells in enumerate(zip(*rows, strict=True)):
        wide = max(map(len, cells))
        columns.append([cell.ljust(wide) if at == 0 else cell.rjust(wide) for cell in cells])
    tables = [columns[:1]]
    for column in columns[1:]:
        length = sum(len(other[0]) + 2 for other in tables[-1]) + len(column[0])
        if width is not None and length > width and len(tables[-1]) > 1:
            tables.append(columns[:1])
        tables[-1] = [*tables[-1], column]
    lines = [["  ".join(row) for row in zip(*table, strict=True)] for table in tables]
    return [line for number, table in enumerate(lines) for line in ([""] if number else []) + table]

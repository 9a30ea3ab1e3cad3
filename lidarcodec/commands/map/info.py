"""`lidarcodec map info` and `map export`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from lidarcodec.commands.running.telling import tell
from lidarcodec.commands.sources import check_not_input
from lidarcodec.errors import DecodeError, SourceError
from lidarcodec.files.whole import check_free, whole
from lidarcodec.maps.export import check_ending, export
from lidarcodec.maps.file import TILE_M, MapReader, read_map


def run(source: Path, as_json: bool) -> None:
    """Read every tile, and print what the map holds."""
    with MapReader.open(source) as reader:
        head, places = reader.head, reader.places
        size = source.stat().st_size
        low, high = [float("inf")] * 3, [float("-inf")] * 3
        try:
            for tile in reader.tiles():
                low = [min(a, float(b)) for a, b in zip(low, tile.steps.min(axis=0) * head.step_m, strict=True)]
                high = [max(a, float(b)) for a, b in zip(high, tile.steps.max(axis=0) * head.step_m, strict=True)]
        except DecodeError as error:
            raise SourceError(f"cannot read the map {source}: {error}") from None
        found: dict[str, Any] = {
            "points": len(reader),
            "bytes": size,
            "bits_per_point": round(8 * size / max(len(reader), 1), 2),
            "length_m": round(reader.length_m, 1),
            "bytes_per_km": round(size / reader.length_m * 1000) if reader.length_m else None,
            "tiles": len(places),
            "tile_m": TILE_M,
            "step_m": head.step_m,
            "columns": list(head.columns),
            "frame": head.frame.name,
            "origin": list(head.frame.origin) if head.frame.zone else None,
            "least_m": [round(value, 3) for value in low] if places else None,
            "most_m": [round(value, 3) for value in high] if places else None,
            "path_places": len(reader.path),
        }
    lines = (
        f"{name:<16} {', '.join(map(str, value)) if isinstance(value, list) else value}"
        for name, value in found.items()
        if value is not None
    )
    tell(found, "\n".join(lines), as_json)


def run_export(source: Path, out: Path, force: bool, as_json: bool) -> None:
    """Write the points in the format of the output's ending."""
    check_ending(out)
    check_free(out, force=force)
    check_not_input(out, source)
    points = read_map(source)
    with whole(out, force=force) as output:
        export(points, output.beside, out.suffix.lower())
    kept = str(output.kept or out)
    tell({"output": kept, "points": len(points)}, f"{kept}: {len(points):,} points", as_json)

"""`lidarcodec map compress`: keeps some of the points of a map."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lidarcodec.commands.map.build import check_map_name
from lidarcodec.commands.progress import progress
from lidarcodec.commands.running.telling import tell
from lidarcodec.commands.selection.numbers import shares_of
from lidarcodec.commands.sources import check_not_input
from lidarcodec.errors import SettingsError
from lidarcodec.files.whole import whole
from lidarcodec.maps.compress import compressed, fitted
from lidarcodec.maps.file import read_map, write_map
from lidarcodec.maps.points import MapPoints
from lidarcodec.maps.select.table import method


@dataclass(frozen=True)
class Asked:
    """The options of `map compress`."""

    source: Path
    out: Path
    keep: str | None
    size: int | None
    by: str
    weights: Path | None
    normals: bool
    seed: int

    def shares(self) -> list[float]:
        """Shares of the points to keep, 0 to 1; empty for `--bytes`. Raises SettingsError."""
        if (self.keep is None) == (self.size is None):
            raise SettingsError("give either --keep, such as 5%, or --bytes N", "keep")
        return [] if self.keep is None else shares_of("--keep", self.keep)

    def outputs(self, shares: list[float]) -> list[Path]:
        """The names of the maps to write: with several shares, OUT-20.lcmap for 20 %."""
        if len(shares) < 2:
            return [self.out]
        return [self.out.with_name(f"{self.out.stem}-{100 * share:g}{self.out.suffix}") for share in shares]


def run(asked: Asked, force: bool, as_json: bool) -> None:
    """Write the maps, and print a line for each."""
    shares = asked.shares()
    select = method(asked.by, asked.weights)
    outputs = asked.outputs(shares)
    if len(set(outputs)) < len(outputs):
        raise SettingsError(f"--keep {asked.keep}: give each share only once", "keep")
    for out in outputs:
        check_map_name(out, force=force)
        check_not_input(out, asked.source)
    points = read_map(asked.source)
    if not asked.normals:
        points = points.with_columns(*(name for name in points.columns if not name.startswith("normal")))
    found: list[dict[str, Any]] = []
    with progress(f"compressing {asked.source.name}", len(outputs)) as tick:
        for out, share in zip(outputs, shares or (None,), strict=True):
            if share is None:
                assert asked.size is not None
                made, about = fitted(points, asked.by, asked.size, asked.seed, select)
            else:
                made, about = compressed(points, asked.by, int(share * len(points)), asked.seed, select)
            found.append({"output": str(out), "bytes": _written(made, out, force), "of": len(points), **about})
            tick()
    tell(found, "\n".join(map(_line, found)), as_json)


def _line(one: dict[str, Any]) -> str:
    own = {name: value for name, value in one.items() if name not in ("output", "bytes", "of", "by", "points")}
    more = "".join(f", {name.replace('_', ' ')} {_text(value)}" for name, value in own.items())
    return f"{one['output']}: {one['points']:,} of {one['of']:,} points by {one['by']}, {one['bytes']:,} bytes{more}"


def _text(value: float | str) -> str:
    return value if isinstance(value, str) else f"{value:g}"


def _written(points: MapPoints, out: Path, force: bool) -> int:
    with whole(out, force=force) as output, output.beside.open("w+b") as file:
        write_map(file, points)
        return file.tell()

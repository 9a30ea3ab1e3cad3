"""Large archives whose objects have the right names, and as much in them as is read: for benchmarks.archive."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from lidarcodec.archive.inputs import inputs_of
from lidarcodec.archive.names import Commit, PlanName, id_of, json_of
from lidarcodec.archive.plan import archive_settings
from lidarcodec.archive.scratch import scratch_folder
from lidarcodec.archive.stores.folder import FolderStore
from lidarcodec.archive.table import COLUMNS, write_table
from lidarcodec.commands.settings import one_setting
from lidarcodec.wire.header import MAJOR, MINOR

SEGMENTS_EACH: Final = 20
"""Of an input."""
BEGIN_NS: Final = 1_700_000_000 * 10**9
SEGMENT_NS: Final = 40 * 10**9
_VALUES: Final = {
    "sensor": "'roof'", "model": "'hdl64e'", "time": "make_timestamp_ns(stamp)", "stamp_ns": "stamp", "frame": "number",
    "points": "100000", "pose": "[1.0, 0, 0, number, 0, 1, 0, 2, 0, 0, 1, 3]", "codec": "'pcodec'", "key": "true",
    "offset": "number * 150000", "length": "150000", "bytes": "150000", "checksum": "hash(number) % 4294967296",
}  # fmt: skip


def many_inputs(folder: Path, count: int) -> None:
    """So many empty captures of 100 vehicles."""
    for number in range(count):
        path = folder / f"car-{number % 100:03d}" / "roof" / f"drive-{number:06d}.pcap"
        if number < 100:
            path.parent.mkdir(parents=True)
        path.touch()


def many_segments(folder: Path, count: int) -> tuple[Path, Path]:
    """Inputs, and an archive with so many segments of them: plans, commits and a joined table."""
    source, target = folder / "in", folder / "out"
    many_inputs(source, count // SEGMENTS_EACH)
    store = FolderStore(target)
    settings = archive_settings(one_setting("pcodec", [])).model_dump(mode="json")
    segments: list[str] = []
    for one in inputs_of(FolderStore(source).entries()):
        origin = one.id(settings, 40.0, [MAJOR, MINOR])
        store.create(PlanName(one.name_id(), one.id(), origin, SEGMENTS_EACH).object, b"{}")
        for number in range(SEGMENTS_EACH):
            first = BEGIN_NS + number * SEGMENT_NS
            segments.append(id_of("segment", origin, number))
            store.create(Commit(one.vehicle, one.sensor, first, first + SEGMENT_NS, origin, segments[-1]).name, b"{}")
    for at in range(0, len(segments), 4000):
        _joined(store, segments[at : at + 4000])
    return source, target


def _joined(store: FolderStore, segments: list[str]) -> None:
    ident = id_of("index", segments)
    with scratch_folder() as folder:
        write_table([dict.fromkeys(COLUMNS)], folder / "joined.parquet")
        store.create(f"index/{ident}.parquet", folder / "joined.parquet")
    size = store.size(f"index/{ident}.parquet")
    store.create(f"index/{ident}.json", json_of({"segments": segments, "bytes": size}))


def many_tables(folder: Path, count: int, frames: int) -> Path:
    """An archive of ten vehicles with so many segments, and tables with so many frames each. Returns the folder."""
    import duckdb

    store = FolderStore(folder)
    with duckdb.connect(config={"threads": 1}) as connection:
        for number in range(count):
            vehicle, segment = f"car-{number % 10}", id_of("segment", number)
            first = BEGIN_NS + number // 10 * SEGMENT_NS
            values = _VALUES | {"vehicle": f"'{vehicle}'", "segment": f"'{segment}'", "object": f"'{segment}.mcap'"}
            columns = ", ".join(
                f'CAST({values.get(name, "number * 1.5")} AS {kind}) AS "{name}"' for name, kind in COLUMNS.items()
            )
            path = folder / "frames" / vehicle / "roof" / f"{segment}-{'0' * 16}.parquet"
            path.parent.mkdir(parents=True, exist_ok=True)
            connection.execute(
                f"COPY (SELECT {columns} FROM (SELECT number, {first} + number * 100000000 AS stamp FROM "
                f"range({frames}) _(number))) TO '{path}' (FORMAT parquet, COMPRESSION zstd)"
            )
            commit = Commit(vehicle, "roof", first, first + SEGMENT_NS, id_of("origin", number), segment)
            store.create(commit.name, b"{}")
    return folder

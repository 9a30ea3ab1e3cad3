"""`lidarcodec archive push`: uploads the recordings of a vehicle."""

from __future__ import annotations

from pathlib import Path

from lidarcodec.archive.push import Rate, push
from lidarcodec.archive.stores.table import open_store
from lidarcodec.commands.progress import progress
from lidarcodec.commands.results.archive import ArchivePushed
from lidarcodec.commands.running.stopping import StoppedError, stoppable
from lidarcodec.commands.running.telling import tell
from lidarcodec.errors import SourceError


def run(folder: Path, where: str, limit_mbit: float | None, delete: bool, as_json: bool) -> bool:
    """Upload all recordings that are complete, and print what was done. Returns whether all could be read."""
    if not folder.is_dir():
        raise SourceError(f"{folder} is not a folder")
    store = open_store(where)
    rate = Rate(None if limit_mbit is None else limit_mbit * 1e6 / 8)
    with stoppable() as stopped, progress("uploading") as tick:
        counts = push(folder, store, rate=rate, delete=delete, stopped=stopped, tick=tick)
    if counts.pop("interrupted", 0):
        raise StoppedError("stopped: run the same command again to continue")
    result = {name: counts[name] for name in ArchivePushed.__annotations__}
    numbers = ", ".join(f"{number:,} {name.replace('_', ' ')}" for name, number in result.items() if number)
    tell(result, numbers or "no recordings", as_json)
    return not counts["unreadable"]

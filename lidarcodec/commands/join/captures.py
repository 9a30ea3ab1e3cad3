"""Joins captures: copies every record unchanged, with any content."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from functools import partial
from ipaddress import ip_address
from pathlib import Path

from lidarcodec.commands.capture_records import ORDERS, named_beside, opened, records, said_beside, tables_of
from lidarcodec.commands.progress import progress
from lidarcodec.commands.running.stopping import StoppedError, Watched, stoppable
from lidarcodec.commands.running.telling import tell
from lidarcodec.errors import SettingsError
from lidarcodec.files.regular import open_regular
from lidarcodec.files.whole import check_free, whole
from lidarcodec.sources.captures.source import Sender, senders_of
from lidarcodec.units import counted

logger = logging.getLogger(__name__)


def run(paths: Sequence[Path], out: Path, allow_gap: bool, force: bool, as_json: bool = False) -> None:
    """Copy the parts, and the calibration next to them.

    Raises SourceError for a damaged part. If gaps are allowed, its complete packets are copied instead.
    """
    found_beside = _beside(paths).items()
    tables = {one: table for one, table in found_beside if _to_be_written(named_beside(out, one), table, force)}
    count = 0
    with (
        stoppable() as stopped,
        whole(out, force=force) as output,
        progress("joining") as tick,
        output.beside.open("wb") as to,
    ):
        header = b""
        last = (0, 0)
        for path in paths:
            with open_regular(path) as handle:
                found = opened(handle, path)
                if header and found != header:
                    raise SettingsError(
                        f"{path} has another pcap format than {paths[0]}: convert both first with `lidarcodec convert`"
                    )
                if not header:
                    header = found
                    to.write(header)
                watched = Watched(records(handle, path, ORDERS[header[:4]], allow_gap), stopped)
                for number, record in enumerate(watched):
                    if number == 0 and record.stamp < last:
                        raise SettingsError(
                            f"{path} begins before the previous part ends: give the parts in order, and without overlap"
                        )
                    last = max(last, record.stamp)
                    to.write(record.data)
                    count += 1
                tick()
                if watched.cut:
                    raise StoppedError(f"stopped: {out} was not written, and the parts were not changed")
        if output.straight:
            tables = {}
        for ending, table in tables.items():
            output.companion(partial(named_beside, ending=ending), Path(ending).suffix or ending).write_bytes(table)
    written = [named_beside(output.kept, ending) for ending in tables] if output.kept is not None else []
    _say_others(paths, output.kept or out)
    tell(
        {
            "output": str(output.kept),
            "beside": [str(one) for one in written],
            "parts": len(paths),
            "messages": None,
            "packets": count,
            "twice": 0,
        },
        f"{output.kept}: {counted(count, 'packet')} of {len(paths)} parts"
        + "".join(f"; {said_beside(one)}" for one in written),
        as_json,
    )


def _say_others(paths: Sequence[Path], out: Path) -> None:
    """Warn of the first part with other sensors than the first part: nothing reads two sensors as one drive."""
    first = senders_of(paths[0])
    for path in paths[1:]:
        found = senders_of(path)
        if not first or not found or {_who(one) for one in first} & {_who(one) for one in found}:
            continue
        address, port = found[0].stream
        if found[0].stream in [one.stream for one in first]:
            remedy = f"both come from the same address, so only `lidarcodec cut {out}` by time separates them"
        else:
            source = f"src={ip_address(address)}"
            source += f"&port={port}" if address in [one.stream[0] for one in first] else ""
            remedy = f'"{out}" is read as the first, "{out}?{source}" as the second'
        logger.warning("%s is of %s, but %s is of %s: %s", paths[0], first[0], path, found[0], remedy)
        return


def _who(sender: Sender) -> tuple[bytes, str]:
    return sender.stream[0], sender.model


def _beside(paths: Sequence[Path]) -> dict[str, bytes]:
    """Calibration and metadata next to the parts, by ending.

    Raises SettingsError if there are different calibrations, CalibrationError if one is too large.
    """
    found: dict[str, tuple[Path, bytes]] = {}
    for path in paths:
        for ending, table in tables_of(path).items():
            first, before = found.setdefault(ending, (path, table))
            if table == before:
                continue
            if ending == ".json":  # an Ouster tells another one after each start
                logger.warning("the metadata next to %s and %s differ: that of %s is taken", path, first, first)
                continue
            raise SettingsError(
                f"the calibrations next to {path} and {first} differ: the captures come from two sensors"
            )
    return {ending: table for ending, (_, table) in found.items()}


def _to_be_written(path: Path, table: bytes, force: bool) -> bool:
    """Whether the calibration must be written. Raises SettingsError if there is already another one."""
    if path.is_file() and not path.is_symlink() and path.stat().st_size == len(table) and path.read_bytes() == table:
        return False
    check_free(path, force=force)
    return True

"""What `cut` writes: one file, or numbered parts, each of them whole when it has its name."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import BinaryIO, TypeVar

from lidarcodec.commands.capture_records import said_beside
from lidarcodec.commands.progress import progress
from lidarcodec.commands.results.files import CutOut
from lidarcodec.commands.running.stopping import StoppedError, Watched, stoppable
from lidarcodec.commands.running.telling import tell
from lidarcodec.commands.selection.frames import Selection
from lidarcodec.errors import SourceError
from lidarcodec.files.whole import Whole, beside, check_free, whole
from lidarcodec.units import counted

Item = TypeVar("Item")


@dataclass(frozen=True)
class Cut:
    """What is to be cut. every_ns: length of the parts, None for one part"""

    source: Path
    out: Path
    selection: Selection
    every_ns: int | None
    force: bool
    as_json: bool

    def name(self, number: int) -> Path:
        """The name of a part."""
        return self.out if self.every_ns is None else beside(self.out, f"-{number:03d}")


def write(
    wanted: Cut,
    items: Iterable[tuple[int, Item]],
    write_part: Callable[[Whole, BinaryIO, Iterable[Item]], int],
) -> tuple[list[Path], int]:
    """Write each run of items with the same part number into a file of its own.

    write_part: writes the items of one part into an open file, and returns their number
    Returns the files, and the number of all items. Raises SourceError if there are none, StoppedError after a signal:
    parts that are complete stay.
    """
    check_free(wanted.name(0), force=wanted.force)
    written: list[Path] = []
    count = 0
    with stoppable() as stopped, progress("cutting") as tick:
        watched = Watched(items, stopped)
        for number, part in groupby(watched, key=lambda item: item[0]):
            with whole(wanted.name(number), force=wanted.force) as output, output.beside.open("wb") as handle:
                count += write_part(output, handle, (item for _, item in part))
                if watched.cut:
                    raise StoppedError(f"stopped: {_kept(written)}, and {wanted.source} was not changed")
            written.append(output.kept or wanted.name(number))
            tick()
    if not written:
        raise SourceError(f"{wanted.source} has {wanted.selection.nothing()}: nothing was written")
    return written, count


def say(
    wanted: Cut, written: list[Path], beside_them: list[Path], count: int, what: str, earlier: int, instead: str = ""
) -> None:
    """Print what was written. what: messages or packets;  earlier: frames before the wanted ones, which they need

    instead: a sentence on how to have none
    """
    result = CutOut(
        outputs=[str(path) for path in written],
        beside=[str(path) for path in beside_them],
        messages=count if what == "messages" else None,
        packets=count if what == "packets" else None,
        earlier_frames=earlier,
    )
    where = str(written[0]) if len(written) == 1 else f"{written[0]} to {written[-1].name}"
    text = f"{where}: {counted(count, what.removesuffix('s'))}"
    if wanted.every_ns is not None:
        text += f" in {counted(len(written), 'part')}"
    if earlier:
        text += f"; it begins with the key frame that the others need, {earlier} earlier than asked"
    if beside_them:
        text += f"; {said_beside(beside_them[0])}" + f" and {len(beside_them) - 1} more" * (len(beside_them) > 1)
    tell(result, text + instead, wanted.as_json)


def _kept(written: list[Path]) -> str:
    return f"complete are {', '.join(map(str, written))}" if written else "nothing was written"

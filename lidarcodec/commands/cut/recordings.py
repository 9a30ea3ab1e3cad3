"""Cuts recordings: copies messages byte for byte. Each part begins with a key frame, so that it decodes alone."""

from __future__ import annotations

import logging
from bisect import bisect
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import BinaryIO, Final, NamedTuple

from lidarcodec import wire
from lidarcodec.commands.cut.parts import Cut, say, write
from lidarcodec.commands.selection.frames import Selection
from lidarcodec.errors import DecodeError, SettingsError, SourceError
from lidarcodec.files.regular import open_regular
from lidarcodec.files.whole import Whole
from lidarcodec.layers import peek_refinement
from lidarcodec.recording import RecordingReader, RecordingWriter
from lidarcodec.recording.damage import is_damaged
from lidarcodec.recording.layout import MESSAGE_ENCODING, PACKET_ENCODING, REFINE_ENCODING
from lidarcodec.recording.order import REACH
from lidarcodec.recording.records import Channel, Stored
from lidarcodec.units import counted

logger = logging.getLogger(__name__)

_MOST_HELD: Final = 1000
"""Most messages that wait for refinements of the part before."""
_REMEMBERED: Final = 64
"""Newest frames whose part is remembered for their refinements: more than any refinement is late."""


class Unit(NamedTuple):
    """A message of frames, or a batch of packets. key: whether it needs no other one;  frames: how many it has"""

    stamp_ns: int
    key: bool
    frames: int


@dataclass(frozen=True)
class Plan:
    """Which units are copied, and where parts begin. starts: numbers of the first units of all parts;  end: the number
    after the last unit;  earlier: copied frames before the wanted ones;  skipped: all frames before the wanted ones;
    frames: wanted ones"""

    starts: tuple[int, ...]
    end: int
    earlier: int
    skipped: int = 0
    frames: int = 0

    def part(self, unit: int) -> int | None:
        """The part of a unit; None if it is not copied."""
        if not self.starts or not self.starts[0] <= unit < self.end:
            return None
        return bisect(self.starts, unit) - 1


def run(wanted: Cut) -> None:
    """Copy messages, and the points and poses recorded with them, into one recording or into parts."""
    with open_regular(wanted.source) as handle:
        reader = RecordingReader(handle)
        if "vehicle" not in reader.metadata or "sensor" not in reader.metadata:
            raise SourceError(
                f"cut needs a recording of lidarcodec, and {wanted.source} is not one: use `lidarcodec convert` "
                "with the same options"
            )
        plan = planned(units_of(reader), wanted.selection, wanted.every_ns)
        for number in range(1, len(plan.starts)):
            if wanted.name(number).exists() and not wanted.force:
                raise SettingsError(f"{wanted.name(number)} exists: choose another name, or use --force", "force")

        damaged = 0

        def write_part(_: Whole, to: BinaryIO, part: Iterable[tuple[Channel, Stored]]) -> int:
            about = {name: text for name, text in reader.metadata.items() if name != "joined"}
            clouds = any("/points" in channel.topic for channel in reader.channels.values())
            writer = RecordingWriter(to, about["vehicle"], about["sensor"], None, about, clouds=clouds)
            nonlocal damaged
            count = 0
            for channel, stored in part:
                damaged += is_damaged(channel, stored)
                writer.copy(channel, reader.schemas.get(channel.schema, ""), stored)
                count += 1
            writer.close()
            return count

        copied = RecordingReader(handle, warn=False)
        written, count = write(wanted, numbered(copied, plan), write_part)
    if damaged:
        logger.warning("%s: copied as they are, though damaged: %s", wanted.source, counted(damaged, "message"))
    instead = ""
    if plan.earlier and wanted.every_ns is None:
        numbers = f"--skip {plan.skipped} --frames {plan.frames}"
        instead = (
            f". To begin exactly: `lidarcodec encode {wanted.source} {wanted.out} {numbers} --codec pcodec --force`"
        )
    say(wanted, written, [], count, "messages", plan.earlier, instead)


def _is_unit(channel: Channel) -> bool:
    return channel.encoding in (MESSAGE_ENCODING, PACKET_ENCODING)


def units_of(reader: RecordingReader) -> list[Unit]:
    """The messages of frames and batches of packets of a recording, in the order of the file."""
    found = []
    for channel, stored in reader.everything():
        if channel.encoding == PACKET_ENCODING:
            found.append(Unit(stored.log_time, True, 0))
        elif channel.encoding == MESSAGE_ENCODING:
            try:
                header = wire.peek(stored.data(wire.HEADER_BYTES))
            except DecodeError:
                found.append(Unit(stored.log_time, False, 0))
            else:
                found.append(Unit(stored.log_time, header.key, header.frame_count))
    return found


def planned(units: Sequence[Unit], selection: Selection, every_ns: int | None) -> Plan:
    """The plan of a cut. It begins with the last key frame at or before the first wanted frame, or else with the first
    key frame.

    Raises SettingsError if frames are counted and there are none.

    >>> units = [Unit(n * 10**8, n % 2 == 0, 1) for n in range(6)]
    >>> planned(units, Selection(skip=3, frames=2), None)
    Plan(starts=(2,), end=5, earlier=1, skipped=3, frames=2)
    >>> planned(units, Selection(begin="0.2"), 2 * 10**8).starts
    (2, 4)
    """
    if (selection.skip or selection.frames is not None) and units and not any(unit.frames for unit in units):
        raise SettingsError("--frames and --skip count frames of messages, but this recording has packets", "frames")
    wanted = [number for number, _ in _chosen(units, selection)]
    if not wanted:
        return Plan((), 0, 0)
    first, end = wanted[0], wanted[-1] + 1
    keys = [number for number in range(end) if units[number].key]
    start = max((number for number in keys if number <= first), default=keys[0] if keys else end)
    starts, part_ns = [start], units[start].stamp_ns
    for number in keys if every_ns is not None else ():
        if number > start and every_ns is not None and units[number].stamp_ns - part_ns >= every_ns:
            starts.append(number)
            part_ns = units[number].stamp_ns
    if start >= end:
        return Plan((), 0, 0)
    earlier, skipped, frames = (
        sum(unit.frames for unit in of) for of in (units[start:first], units[:first], units[first:end])
    )
    return Plan(tuple(starts), end, earlier, skipped, frames)


class _Counted(NamedTuple):
    stamp_ns: int
    number: int


def _chosen(units: Sequence[Unit], selection: Selection) -> Iterator[tuple[int, Unit]]:
    """Units with a wanted frame. A unit of several frames is taken whole."""
    passed = 0
    stamped = (_Counted(unit.stamp_ns, number) for number, unit in enumerate(units))
    for one in selection.in_time(stamped, whole=True):
        unit = units[one.number]
        after = passed + unit.frames
        if selection.frames is not None and passed >= selection.skip + selection.frames:
            return
        if after > selection.skip or (not unit.frames and passed >= selection.skip):
            yield one.number, unit
        passed = after


class _Held(NamedTuple):
    part: int
    unit: int
    item: tuple[Channel, Stored]


def numbered(reader: RecordingReader, plan: Plan) -> Iterator[tuple[int, tuple[Channel, Stored]]]:
    """Every message that is copied, with the number of its part. Points and poses belong to the unit before them,
    refinements to their frame: those that come up to REACH units later go before the next part."""
    held: list[_Held] = []  # what begins the next parts
    parts: dict[tuple[int, int], int | None] = {}  # of frames, by stream and index
    unit, written = -1, 0
    for channel, stored in reader.everything():
        unit += _is_unit(channel)
        part = plan.part(unit)
        if channel.encoding == REFINE_ENCODING:
            part = parts.get(_base_of(stored), part)
        elif channel.encoding == MESSAGE_ENCODING:
            parts[_frame_of(stored)] = part
            if len(parts) > _REMEMBERED:
                del parts[next(iter(parts))]
        if part is not None and part <= written:
            yield part, (channel, stored)
        elif part is not None:
            held.append(_Held(part, unit, (channel, stored)))
        while held and (unit - held[0].unit > REACH or len(held) > _MOST_HELD):
            written = held[0].part
            yield from ((written, one.item) for one in held if one.part == written)
            held = [one for one in held if one.part != written]
    for one in sorted(held, key=lambda one: one.part):  # keeps the order within a part
        yield one.part, one.item


def _frame_of(stored: Stored) -> tuple[int, int]:
    try:
        header = wire.peek(stored.data(wire.HEADER_BYTES))
    except DecodeError:
        return -1, -1
    return header.stream_id, header.frame_index


def _base_of(stored: Stored) -> tuple[int, int]:
    try:
        head = peek_refinement(stored.data())
    except DecodeError:
        return -1, -1
    return head.stream_id, head.frame_index

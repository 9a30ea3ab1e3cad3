"""Which frames of a source a command takes: `--from` and `--to` by time, then `--skip` and `--frames` by number.

A TIME is a number of seconds from the beginning of the source, RFC 3339, or nanoseconds since 1970.

>>> time_of("2.5", 1_000_000_000)
3500000000
>>> time_of("2026-11-26T13:00:00Z", 0)
1795698000000000000
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from itertools import chain, islice
from typing import Final, Protocol, TypeVar

from lidarcodec.errors import SettingsError
from lidarcodec.untrusted.times import rfc_3339, time_ns_of

MOST_SECONDS: Final = 1e9
"""A larger number is in nanoseconds since 1970."""


class Stamped(Protocol):
    """A frame, a packet or a message."""

    @property
    def stamp_ns(self) -> int:
        """Host time in ns since 1970."""


Item = TypeVar("Item", bound=Stamped)
AFTER_NS: Final = 2 * 10**9


def time_of(text: str, begin_ns: int) -> int:
    """A time in ns since 1970. begin_ns: beginning of the source

    Raises SettingsError.
    """
    try:
        seconds = float(text)
    except ValueError:
        seconds = math.inf
    if abs(seconds) <= MOST_SECONDS:
        return begin_ns + round(seconds * 1e9)
    try:
        return time_ns_of(text)
    except SettingsError:
        raise SettingsError(
            f"{text} is not a time: write seconds from the beginning, such as 12.5, or 2026-11-26T13:00:00Z", "from"
        ) from None


@dataclass(frozen=True)
class Selection:
    """What a command takes. frames, skip: numbers of frames;  begin, end: texts of times, the end is not included

    span: first and last time of a source that was read to its end, in ns since 1970; empty of another
    """

    frames: int | None = None
    skip: int = 0
    begin: str | None = None
    end: str | None = None
    span: list[int] = field(default_factory=list, init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        begin, end = (None if text is None else time_of(text, 0) for text in (self.begin, self.end))
        same_kind = (begin is None or end is None) or (begin >= 10**18) == (end >= 10**18)
        if begin is not None and end is not None and same_kind and end <= begin:
            raise SettingsError(f"--to {self.end} is not after --from {self.begin}", "to")

    @property
    def by_time(self) -> bool:
        """Whether a time was given."""
        return self.begin is not None or self.end is not None

    def in_time(self, items: Iterable[Item], *, whole: bool = False) -> Iterator[Item]:
        """Items from `begin` on and before `end`. They come in the order of their times, or nearly so.

        whole: whether to read all of them. Otherwise they end behind AFTER_NS of items that are later than `end`: a
        single wrong time does not end them
        """
        self.span.clear()
        rest = iter(items)
        first = next(rest, None)
        if first is None:
            return
        begin_ns = None if self.begin is None else time_of(self.begin, first.stamp_ns)
        end_ns = None if self.end is None else time_of(self.end, first.stamp_ns)
        last_ns = first.stamp_ns
        after_ns: int | None = None  # first of the items in a row that are later than the end
        for item in chain((first,), rest):
            last_ns = max(last_ns, item.stamp_ns)
            if end_ns is not None and item.stamp_ns >= end_ns:
                after_ns = item.stamp_ns if after_ns is None else after_ns
                if not whole and item.stamp_ns - after_ns >= AFTER_NS:
                    return
                continue
            after_ns = None
            if begin_ns is None or item.stamp_ns >= begin_ns:
                yield item
        self.span.extend((first.stamp_ns, last_ns))

    def of(self, items: Iterable[Item]) -> Iterator[Item]:
        """The items that are taken."""
        return islice(self.in_time(items), self.skip, None if self.frames is None else self.skip + self.frames)

    def nothing(self) -> str:
        """What a source without any such item lacks, for an error: `no frame after the first 3`."""
        times = [f"{word} {text}" for word, text in (("from", self.begin), ("to", self.end)) if text is not None]
        skipped = [f"after the first {self.skip}"] if self.skip or not times else []
        lasts = []
        if times and self.span:
            first_ns, last_ns = self.span
            lasts = [f"(it begins at {rfc_3339(first_ns)} and lasts {(last_ns - first_ns) / 1e9:.1f} s)"]
        return " ".join(["no frame", *skipped, *times, *lasts])

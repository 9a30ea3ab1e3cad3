"""Pieces of segments for many readers of an archive: which of them a reader gets, and in which order they are mixed.

Every piece goes to one reader, so together they see each frame once. All readers must know the same segments.

>>> [[piece.part.number for piece in share_of(["a"], lambda one: one, Share(number, 2))] for number in (0, 1)]
[[0, 2, 4, 6, 8, 10, 12, 14], [1, 3, 5, 7, 9, 11, 13, 15]]
>>> list(mixed(iter([iter("abc"), iter("def")]), at_once=2, buffer=3, order=Random(1)))
['b', 'c', 'a', 'd', 'e', 'f']
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Sequence
from itertools import islice
from random import Random
from typing import Final, Generic, NamedTuple, TypeVar

from lidarcodec.archive.messages import Part

PIECES: Final = 8
"""Fewest pieces for each reader: of few segments, each is read by many."""
Segment = TypeVar("Segment")
Item = TypeVar("Item")


class Share(NamedTuple):
    """The reader `number` of `of`."""

    number: int
    of: int


class Piece(NamedTuple, Generic[Segment]):
    """A part of a segment."""

    segment: Segment
    part: Part


def share_of(
    segments: Sequence[Segment], name: Callable[[Segment], str], share: Share, order: str | None = None
) -> list[Piece[Segment]]:
    """The pieces of a reader.

    name: a text of a segment, different for each;  order: a text that the order follows from; None: as they are given
    """
    parts = -(-PIECES * share.of // len(segments)) if 0 < len(segments) < PIECES * share.of else 1
    pieces = [Piece(one, Part(number, parts)) for one in segments for number in range(parts)]
    if order is not None:  # by hashes: equal on all machines and in all versions of Python
        pieces.sort(key=lambda one: hashlib.sha256(f"{order}/{one.part.number}/{name(one.segment)}".encode()).digest())
    return pieces[share.number :: share.of]


def mixed(parts: Iterator[Iterator[Item]], at_once: int, buffer: int, order: Random) -> Iterator[Item]:
    """Items of all parts, each once, in random order: drawn from `at_once` parts, and from `buffer` items of these."""
    opened, held = list(islice(parts, at_once)), list[Item]()
    while opened:
        at = order.randrange(len(opened))
        for item in opened[at]:
            if len(held) < buffer:
                held.append(item)
                break
            place = order.randrange(buffer)
            held[place], item = item, held[place]  # noqa: PLW2901
            yield item
            break
        else:
            opened[at : at + 1] = islice(parts, 1)
    order.shuffle(held)
    yield from held

"""Messages of a segment, read from a store in few requests: those with the frames that are wanted, and those that
decoding them needs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Final, NamedTuple

from lidarcodec.archive.names import Commit
from lidarcodec.archive.objects import Place, places_of, read_commit
from lidarcodec.archive.stores.base import Store
from lidarcodec.errors import ChecksumError, SourceError
from lidarcodec.frame import Frame
from lidarcodec.pipeline import StreamDecoder
from lidarcodec.wire import unpack
from lidarcodec.wire.checksum import checked_body, checksum_of

READ_AHEAD: Final = 64 << 10
"""Gaps of at most so many bytes are read too, which is quicker than another request."""
MAX_READ: Final = 64 << 20
"""Most bytes of a request, so that memory stays bounded."""


class Coded(NamedTuple):
    """A coded message from the archive. wanted: whether its frames were asked for; a key message and others may only
    be needed to decode these"""

    commit: Commit
    place: Place
    data: bytes
    wanted: bool


class Chosen(NamedTuple):
    """A segment with frames that were asked for. offsets: of their messages; None: those of the times asked for"""

    commit: Commit
    offsets: frozenset[int] | None


class Part(NamedTuple):
    """The part `number` of `of` equal ones."""

    number: int
    of: int


WHOLE: Final = Part(0, 1)


def messages_of(
    store: Store, chosen: Chosen, limits: tuple[int, int] | None, part: Part = WHOLE, most: int = MAX_READ
) -> Iterator[Coded]:
    """Messages of a segment that hold the frames, and those that decoding them needs, read in few requests.

    limits: first and last time in ns;  part: only this part of those with the frames
    most: bytes of a request, unless a message has more
    """
    places = places_of(value := read_commit(store, chosen.commit))
    if chosen.offsets is not None and not chosen.offsets <= {place.offset for place in places}:
        raise SourceError(f"{chosen.commit.name} does not have all messages that its table of frames lists")
    fits = _by_time(places, limits) if chosen.offsets is None else _at(chosen.offsets)
    found = [place.offset for place in places if fits(place)]
    first, end = (len(found) * number // part.of for number in (part.number, part.number + 1))
    needed = _needed(places, _at(frozenset(found[first:end])))
    yield from _read(store, chosen.commit, value["object"], needed, most)


def decoded_frames(messages: Iterable[Coded], limits: tuple[int, int] | None) -> Iterator[Frame]:
    """The wanted frames of a segment's messages. limits: first and last time in ns. Raises DecodeError."""
    decoder, numbers = StreamDecoder(), set[int]()
    for one in messages:
        if one.wanted:
            numbers.update(range(one.place.frame, one.place.frame + one.place.frames))
        frames = decoder.decode(unpack(one.data))
        yield from (frame for frame in frames if frame.index in numbers and _inside(frame, limits))
    yield from (frame for frame in decoder.flush() if frame.index in numbers and _inside(frame, limits))


def _read(store: Store, commit: Commit, name: str, needed: list[tuple[Place, bool]], most: int) -> Iterator[Coded]:
    """Messages of a recording, each with whether it is wanted itself. Raises ChecksumError if one is damaged."""
    for first, last in _joined([place for place, _ in needed], most):
        inside = [(place, is_wanted) for place, is_wanted in needed if first <= place.offset < last]
        data = store.read(name, first, last - first)
        for place, is_wanted in inside:
            message = data[place.offset - first : place.offset - first + place.length]
            if len(message) != place.length:
                raise ChecksumError(f"{name} ends before byte {place.offset + place.length}", place.offset)
            if checksum_of(message) != place.checksum:
                raise ChecksumError(
                    f"{name} has another message at byte {place.offset} than was archived", place.offset
                )
            checked_body(message)
            yield Coded(commit, place, message, is_wanted)


def _inside(frame: Frame, limits: tuple[int, int] | None) -> bool:
    return limits is None or limits[0] <= frame.stamp_ns <= limits[1]


def _at(offsets: frozenset[int]) -> Callable[[Place], bool]:
    return lambda place: place.offset in offsets


def _by_time(places: Sequence[Place], limits: tuple[int, int] | None) -> Callable[[Place], bool]:
    """Whether a message may hold frames of a time. A message of several frames reaches to the next one."""
    if limits is None or not places:
        return lambda _: True
    ends = {
        place.offset: place.stamp_ns if place.frames == 1 else max(place.stamp_ns, following.stamp_ns)
        for place, following in zip(places, [*places[1:], places[-1]._replace(stamp_ns=1 << 62)], strict=True)
    }
    return lambda place: place.stamp_ns <= limits[1] and ends[place.offset] >= limits[0]


def _needed(places: Sequence[Place], wanted: Callable[[Place], bool]) -> list[tuple[Place, bool]]:
    """Messages to read, each with whether it is wanted itself. A message needs the key message before it, and those
    that it refers to, directly or not."""
    numbers = {place.frame + more: at for at, place in enumerate(places) for more in range(place.frames)}
    keys: list[int] = []
    for at, place in enumerate(places):
        keys.append(at if place.key or not keys else keys[-1])
    chosen = {at: True for at, place in enumerate(places) if wanted(place)}
    waiting = list(chosen)
    while waiting:
        at = waiting.pop()
        for other in (keys[at], numbers.get(places[at].needs, at)):
            if other not in chosen:
                chosen[other] = False
                waiting.append(other)
    return [(places[at], chosen[at]) for at in sorted(chosen)]


def _joined(places: Sequence[Place], most: int) -> Iterator[tuple[int, int]]:
    """Ranges of bytes (first, end) that cover messages in order, with small gaps between them included."""
    first = last = -1
    for place in places:
        end = place.offset + place.length
        if first >= 0 and 0 <= place.offset - last <= READ_AHEAD and end - first <= most:
            last = end
            continue
        if first >= 0:
            yield first, last
        first, last = place.offset, end
    if first >= 0:
        yield first, last

"""Kept: what is in the ring of a vehicle: which times, pieces and marks. It reads the files and never writes them."""

from __future__ import annotations

import logging
import threading
from bisect import bisect_left
from collections import OrderedDict
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final, NamedTuple, TypeVar

from lidarcodec.errors import LidarCodecError, SettingsError, SourceError
from lidarcodec.files.regular import open_regular
from lidarcodec.recording import RecordingReader
from lidarcodec.recording.marks import MAX_MARKS, OF_OTHERS, Mark, Marks, covered
from lidarcodec.recording.pieces import Piece, pieces_in, read_piece
from lidarcodec.recording.recorded_files import recorded_files
from lidarcodec.transport.keys import StreamKeys

logger = logging.getLogger(__name__)

MARKED_SHARE: Final = 0.5
"""Largest share of the ring that marked files take: the rest stays a ring. Marks over the network may bring it to three
quarters of that, so that nobody takes the room of what the vehicle itself marks."""
MAX_PIECES: Final = 24
"""Most pieces in one answer: 4 kB."""
MAX_SPANS: Final = 64
GAP_NS: Final = 2 * 10**9
"""Files with a longer break between them are listed as two spans."""
FILES_KNOWN: Final = 8
"""Files whose pieces are remembered."""
PIECES_READ: Final = 2
T = TypeVar("T")


class GoneError(SettingsError):
    """A piece is not kept any more."""

    def __init__(self, message: str) -> None:
        super().__init__(message, "piece")


class _Span(NamedTuple):
    """First and last stamp in a file, and its size when they were read."""

    begin_ns: int
    end_ns: int
    size: int


class Kept:
    """The files of a keeper, and its marks. Thread-safe.

    growing: the file that is being written;  totals: for the status, as of the last `look`
    """

    def __init__(self, folder: Path, keys: StreamKeys, max_bytes: int) -> None:
        self.folder, self.keys, self.max_bytes = folder, keys, max_bytes
        self.marks = Marks(folder / f"{keys.vehicle}_{keys.sensor}.marks.json")
        self.growing: Path | None = None
        self.totals: dict[str, Any] = {"bytes": 0, "from_ns": None, "to_ns": None, "marks": 0, "marked_bytes": 0}
        self.totals["marked_ns"] = None
        self._lock = threading.Lock()
        self._spans: dict[str, _Span] = {}
        self._pieces: OrderedDict[tuple[str, int], list[Piece]] = OrderedDict()
        self._read: OrderedDict[str, bytes] = OrderedDict()
        if self.marks.damaged:
            logger.error("%s cannot be read: no kept file is deleted until you repair or remove it", self.marks.path)

    def stays(self, path: Path) -> bool:
        """Whether a file must not be deleted: it has marked messages, or cannot be opened and may have some."""
        if self.marks.damaged:
            return True
        try:
            span = self._read_span(path)
        except FileNotFoundError:
            return False
        except OSError:
            return len(self.marks) > 0
        return span is not None and self.marks.covers(span.begin_ns, span.end_ns + 1)

    def look(self) -> None:
        """Count the totals again."""
        found = self._files()
        spans = [span for _, span in found]
        self.totals = {
            "bytes": sum(span.size for span in spans),
            "from_ns": min((span.begin_ns for span in spans), default=None),
            "to_ns": max((span.end_ns for span in spans), default=None),
            "marks": len(self.marks),
            "marked_ns": max((mark.at_ns for mark in self.marks), default=None),
            "marked_bytes": self._marked_bytes(spans),
        }

    def spans(self) -> list[tuple[int, int]]:
        """Spans of time that are kept, oldest first; the oldest ones are left out if there are too many."""
        merged: list[tuple[int, int]] = []
        for span in sorted(span for _, span in self._files()):
            if merged and span.begin_ns - merged[-1][1] <= GAP_NS:
                merged[-1] = merged[-1][0], max(merged[-1][1], span.end_ns)
            else:
                merged.append((span.begin_ns, span.end_ns))
        return merged[-MAX_SPANS:]

    def pieces(self, from_ns: int, to_ns: int) -> tuple[list[Piece], bool]:
        """The first pieces of a span, in order of time, and whether there are more."""
        found: list[Piece] = []
        for path, span in sorted(self._files(), key=lambda one: one[1].begin_ns):
            if span.begin_ns >= to_ns or (len(found) > MAX_PIECES and span.begin_ns > found[MAX_PIECES].begin_ns):
                break
            if span.end_ns + GAP_NS >= from_ns:  # the last frame goes on after its stamp
                found += [one for one in self._pieces_of(path) if one.overlaps(from_ns, to_ns)]
                found.sort(key=lambda one: (one.begin_ns, one.name))
        return found[:MAX_PIECES], len(found) > MAX_PIECES

    def until_ns(self) -> int | None:
        """End of the newest complete piece; None if there is none.

        Other files may be of a later time, from before the clock was set back: then the rest of a clip is yet to come.
        """
        growing = self.growing
        if growing is not None and (pieces := self._pieces_of(growing)):
            return pieces[-1].end_ns
        return max((span.end_ns for path, span in self._files() if path != growing), default=None)

    def part(
        self, name: str, at_ns: int, offset: int, size: int, before_search: Callable[[], object] = lambda: None
    ) -> bytes:
        """A part of a piece. at_ns: a time in it
        before_search: called before whole files are read for a piece that was not listed lately; may raise

        Raises GoneError if it is not kept any more, SettingsError for an offset outside of it.
        """
        data = self._piece(name, at_ns, before_search)
        if not 0 <= offset < len(data):
            raise SettingsError(f"the piece has {len(data)} bytes", "offset")
        return data[offset : offset + size]

    def mark(self, mark: Mark, *, own: bool = False, instead_of: Sequence[Mark] = ()) -> int:
        """Keep a span from being overwritten, messages that are yet to come among them.

        own: whether the vehicle itself marks it, not somebody over the network
        instead_of: marks that are released, the first ones first, as far as there is no room otherwise

        Returns how many were released. Raises SettingsError if the marked files would take too much of the ring, and
        SourceError; then none is released.
        """
        with self._lock:
            spans = [span for _, span in self._files()]
            written, covered_ns = sum(span.size for span in spans), sum(span.end_ns - span.begin_ns for span in spans)
            ahead_ns = max(0, mark.to_ns - max((span.end_ns for span in spans), default=mark.from_ns))
            rate = written / covered_ns if covered_ns > 10**9 else 0.0
            share = MARKED_SHARE * (1.0 if own else OF_OTHERS)

            def has_room(released: int) -> bool:
                staying = (*self.marks.without(instead_of[:released]), mark)
                if len(staying) > MAX_MARKS and released < len(instead_of):
                    return False
                marked = sum(span.size for span in spans if covered(staying, span.begin_ns, span.end_ns + 1))
                return marked + rate * ahead_ns <= share * self.max_bytes

            if not self.marks.damaged and not has_room(len(instead_of)):
                raise SettingsError(
                    f"the marked files would take more than {share:.1%} of what is kept: release some marks first",
                    "mark",
                )
            released = bisect_left(range(len(instead_of)), True, key=has_room)
            self.marks.add(mark, own=own, instead_of=instead_of[:released])
            return released

    def release(self, name: str) -> bool:
        """Remove a mark. Returns whether there was one. Raises SourceError."""
        with self._lock:
            return self.marks.release(name)

    def _marked_bytes(self, spans: list[_Span]) -> int:
        return sum(span.size for span in spans if self.marks.covers(span.begin_ns, span.end_ns + 1))

    def _files(self) -> list[tuple[Path, _Span]]:
        """Files with messages, and their spans."""
        try:
            paths = recorded_files(self.folder, self.keys.vehicle, self.keys.sensor, list(self._spans))
        except OSError:  # nothing was kept yet
            return []
        names = {path.name for path in paths}
        for name in [name for name in self._spans.copy() if name not in names]:
            self._spans.pop(name, None)
        return [(path, span) for path in paths if (span := self._span(path)) is not None]

    def _span(self, path: Path) -> _Span | None:
        """None if the file cannot be read, or has no whole message."""
        try:
            return self._read_span(path)
        except OSError:
            return None

    def _read_span(self, path: Path) -> _Span | None:
        """None if the file has no whole message. Raises OSError."""
        size = path.stat().st_size
        known = self._spans.get(path.name)
        if known is not None and known.size == size:
            return known
        try:
            with open_regular(path) as file:
                found = RecordingReader(file, warn=False).span()
        except SourceError:
            return None
        if found is None:
            return None
        span = self._spans[path.name] = _Span(*found, size)
        return span

    def _pieces_of(self, path: Path) -> list[Piece]:
        growing = path == self.growing
        try:
            key = path.name, path.stat().st_size
            return self._remembered(self._pieces, key, lambda: pieces_in(path, growing=growing), FILES_KNOWN)
        except (OSError, LidarCodecError) as error:
            logger.debug("%s: %s", path, error)
            return []

    def _piece(self, name: str, at_ns: int, before_search: Callable[[], object]) -> bytes:
        with self._lock:  # most questions are about a piece that was just read, or listed: then no file is searched
            if name in self._read:
                return self._read[name]
            listed = next(
                ((file, piece) for (file, _), pieces in self._pieces.items() for piece in pieces if piece.name == name),
                None,
            )
        if listed is not None:
            return self._read_piece(self.folder / listed[0], listed[1])
        before_search()
        for path, span in self._files():
            if not span.begin_ns <= at_ns <= span.end_ns + GAP_NS:
                continue
            for piece in self._pieces_of(path):
                if piece.name == name:
                    return self._read_piece(path, piece)
        raise GoneError("this piece has been overwritten")

    def _read_piece(self, path: Path, piece: Piece) -> bytes:
        try:
            return self._remembered(self._read, piece.name, partial(read_piece, path, piece), PIECES_READ)
        except FileNotFoundError:
            raise GoneError("this piece has been overwritten") from None
        except (OSError, LidarCodecError) as error:
            raise GoneError(f"the piece cannot be read: {error}") from None

    def _remembered(self, known: OrderedDict[Any, T], key: object, read: Callable[[], T], most: int) -> T:
        with self._lock:
            if key in known:
                known.move_to_end(key)
                return known[key]
        value = read()
        with self._lock:
            known[key] = value
            while len(known) > most:
                known.popitem(last=False)
        return value

"""IP fragments -> whole datagrams, within bounds: memory is bounded for any input.

A sensor's 1248-byte frames are not fragmented in a local network, but in tunnels and with small MTUs. A datagram is
complete when all its bytes are there. Fragments that overlap or contradict each other make it invalid (RFC 5722).
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import Final

MAX_OPEN: Final = 64
"""Most datagrams under reassembly; the oldest is dropped first."""
MAX_DATAGRAM: Final = 65_535

Key = tuple[bytes, bytes, int]


@dataclass
class _Partial:
    pieces: dict[int, bytes] = field(default_factory=dict)
    received: int = 0
    total: int | None = None


class Reassembler:
    """Holds at most 64 datagrams of at most 65535 bytes. Counts `lost fragments` and `bad fragments` (of datagrams)."""

    def __init__(self, counts: Counter[str]) -> None:
        self._counts = counts
        self._open: dict[Key, _Partial] = {}

    def add(self, key: Key, offset: int, more: bool, data: bytes) -> bytes | None:
        """The whole datagram, when this fragment completes it.

        key: sender, receiver and identity; offset: bytes; more: whether further fragments follow
        """
        end = offset + len(data)
        partial = self._open.get(key)
        fits = len(data) > 0 and end <= MAX_DATAGRAM and not (more and len(data) % 8)
        if partial is None:
            if not fits:
                self._counts["bad fragments"] += 1
                return None
            if len(self._open) >= MAX_OPEN:
                del self._open[next(iter(self._open))]
                self._counts["lost fragments"] += 1
            partial = self._open[key] = _Partial()
        if partial.pieces.get(offset) == data:
            return None  # a repeated fragment
        total = partial.total if more else end
        if not fits or offset in partial.pieces or (partial.total not in (None, total)):
            return self._void(key)
        partial.pieces[offset] = data
        partial.received += len(data)
        partial.total = total
        if total is None or partial.received < total:
            return None
        pieces = sorted(partial.pieces.items())
        ends = [at + len(piece) for at, piece in pieces]
        if [at for at, _ in pieces] != [0, *ends[:-1]] or ends[-1] != total:
            return self._void(key)
        del self._open[key]
        return b"".join(piece for _, piece in pieces)

    def finish(self) -> None:
        """Count the datagrams that never became complete."""
        if self._open:
            self._counts["lost fragments"] += len(self._open)
            self._open.clear()

    def _void(self, key: Key) -> bytes | None:
        del self._open[key]
        self._counts["bad fragments"] += 1
        return None

"""PipedCapture: the packets of a capture that comes through a pipe, as from `tcpdump -w -`. It is read once."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Final

from lidarcodec.sources.captures.datagrams import Datagram
from lidarcodec.sources.captures.pcap import Ending
from lidarcodec.sources.captures.source import CaptureSource, stamped_datagrams

MOST_FIRST: Final = 16_384
"""Most datagrams that are kept until the sensor is found: other traffic may be among them."""


class PipedCapture(CaptureSource):
    """As CaptureSource, whose `packets` can be called once. The sensor is found by the first 1,024 packets, which are
    waited for, and 4,160 of an HDL-64E whose calibration table is among them.
    """

    def __init__(self, file: IO[bytes], name: str, calibration: Path | None = None, model: str | None = None) -> None:
        """file: unbuffered, open for reading;  name: for messages. Raises as CaptureSource."""
        self._counted, self._ended = Counter[str](), Ending()
        self._all = stamped_datagrams(Path(name), self._counted, self._ended, file)
        self._first: list[tuple[int, Datagram]] | None = None
        super().__init__(Path(name), calibration, model=model)
        self.live = True

    def finish(self) -> None:
        """Nothing: the program that opened the pipe ends it, and `packets` gives what has come by then."""

    def _check(self) -> Path | None:
        return None  # nothing lies beside a pipe

    def _datagrams(self, counts: Counter[str], ending: Ending) -> Iterator[tuple[int, Datagram]]:
        if self._first is None:
            self._first = []
            return self._kept(self._first, ending)
        return self._from_first(counts, ending)

    def _kept(self, first: list[tuple[int, Datagram]], ending: Ending) -> Iterator[tuple[int, Datagram]]:
        """The first datagrams, by which the sensor is found; they are given again by `packets`."""
        try:
            while len(first) < MOST_FIRST and (one := next(self._all, None)) is not None:
                first.append(one)
                yield one
        finally:
            self._say(ending)

    def _from_first(self, counts: Counter[str], ending: Ending) -> Iterator[tuple[int, Datagram]]:
        first, self._first = self._first or [], []
        yield from itertools.chain(first, self._all)
        counts.update(self._counted)
        self._say(ending)

    def _say(self, ending: Ending) -> None:
        if self._ended.cause is not None:
            ending.set(self._ended.cause, self._ended.text)

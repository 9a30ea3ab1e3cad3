"""Chains of damaged messages: a decoder that has read a valid beginning gets damaged messages, and valid ones between.

A chain is made by a configuration and a number, so that any case can be had again. What a case costs is measured: the
time of this process's threads, and by how much the largest memory it ever had grew.
"""

from __future__ import annotations

import random
import resource
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from lidarcodec.assembly import packets_of
from lidarcodec.errors import DecodeError, LidarCodecError, MissingReferenceError
from lidarcodec.filling import filled
from lidarcodec.message import Message
from lidarcodec.pipeline import StreamDecoder
from lidarcodec.wire import unpack
from tests.fuzz.corpus import Stream
from tests.fuzz.damage import damaged

CASES = 24
"""Damaged messages in a chain."""
_MENDED = 0.4
"""How often a valid message follows a damaged one that refers to another; a third as often where none does."""
_DEEPEST = 6
"""Valid messages that most chains begin with at most."""
_ANYWHERE = 0.25
"""How often a chain begins with any message of its stream, after those that this one needs."""


class Outcome(NamedTuple):
    """What came of a damaged message.

    kind: `decoded`, or the error's name; inter: whether it referred to another; jump_kib: how much the peak of memory
    grew; foreign: an exception that must not be, empty for none
    """

    kind: str
    inter: bool
    seconds: float
    jump_kib: int
    foreign: str = ""


@dataclass
class Chain:
    """A chain at work. history: the messages that the decoder got so far, newest last; refused: valid ones refused."""

    stream: Stream
    number: int
    seed: int
    history: list[bytes] = field(default_factory=list)
    refused: list[str] = field(default_factory=list)

    def run(self) -> Iterator[Outcome]:
        """The outcomes of its cases."""
        rng = random.Random(f"{self.seed}/{self.stream.name}/{self.stream.size}/{self.number}")
        parts = self.stream.parts
        others = [section for message in parts for section in message.sections]
        decoder = StreamDecoder()
        at = self._led_to(decoder, self._start(rng, _DEEPEST))
        for _ in range(CASES):
            message = parts[at]
            inter = message.needs is not None
            outcome = self._fed(decoder, damaged(message, others, rng), inter=inter)
            yield outcome
            if outcome.foreign:
                return
            if rng.random() > (_MENDED if inter else _MENDED / 3):
                continue
            goes_on = self._follows(decoder, at) and at + 1 < len(parts)
            at = at + 1 if goes_on else self._led_to(decoder, self._start(rng, 3))

    def _start(self, rng: random.Random, deepest: int) -> int:
        """The number of a message to begin with: one of the first ones behind a key message, or any."""
        count = len(self.stream.parts)
        keys = [at for at, message in enumerate(self.stream.parts) if message.key and self.stream.parts[0].planes]
        first = rng.choice(keys) if len(keys) > 1 else 0
        return rng.randrange(count) if rng.random() < _ANYWHERE else rng.randrange(first, min(count, first + deepest))

    def _led_to(self, decoder: StreamDecoder, at: int) -> int:
        """The message's number, once a decoder has read the valid ones that it needs."""
        for before in needed(self.stream.parts, at):
            self._follows(decoder, before)
        return at

    def _follows(self, decoder: StreamDecoder, at: int) -> bool:
        """Whether a valid message is decoded. One that refers to another may be refused: that one was damaged."""
        self.history.append(self.stream.messages[at])
        try:
            decoder.decode(self.stream.parts[at])
        except MissingReferenceError:
            return False
        except LidarCodecError as error:
            if self.stream.parts[at].needs is None:
                self.refused.append(f"{type(error).__name__}: {error}")
            return False
        return True

    def _fed(self, decoder: StreamDecoder, data: bytes, *, inter: bool) -> Outcome:
        self.history.append(data)
        before, began, foreign = _peak_kib(), time.process_time(), ""
        try:
            decode_all(decoder, data)
            kind = "decoded"
        except DecodeError as error:
            kind = type(error).__name__
        except Exception as error:  # what this looks for
            kind, foreign = type(error).__name__, f"{type(error).__name__}: {error}"
        return Outcome(kind, inter, time.process_time() - began, _peak_kib() - before, foreign)


def needed(parts: Sequence[Message], at: int) -> list[int]:
    """Numbers of the messages that one needs, in order: those it refers to, and the key message of its calibration."""
    found = []
    while (needs := parts[at].needs) is not None:
        at = next(before for before in reversed(range(at)) if parts[before].frame_index == needs)
        found.append(at)
    if not parts[at].key:
        found.append(next(before for before in reversed(range(at)) if parts[before].key))
    return found[::-1]


def decode_all(decoder: StreamDecoder, data: bytes) -> None:
    """Everything a receiver does with the bytes of a message."""
    for frame in decoder.decode(unpack(data)):
        frame.cloud()
        if (shown := filled(frame)) is not frame:
            shown.cloud()
        if not frame.sensor.is_hdl64e:
            frame.cloud("all")
        if frame.side is not None:
            packets_of(frame)


def _peak_kib() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss

"""Live turns in parts: sent while they are measured, put together where turns are wanted; a lost part costs no key."""

from __future__ import annotations

import struct
from collections import deque

import numpy as np
import pytest

from lidarcodec.apps.mailbox import Mailbox
from lidarcodec.apps.publisher.flight import Flight
from lidarcodec.apps.publisher.references import References
from lidarcodec.apps.receiver import turn_inbox
from lidarcodec.apps.receiver.turn_inbox import DEPTH, TurnInbox
from lidarcodec.pipeline import frames_of
from lidarcodec.settings import MAX_PARTS, StreamSettings
from lidarcodec.transport.base import Priority
from tests.apps.in_memory import live, publisher
from tests.apps.streams import Loop

TURNS = 3


@pytest.mark.parametrize("codec", ["pcodec", "predictive"])
@pytest.mark.parametrize("parts", [False, True])
def test_a_receiver_gets_turns_or_parts_and_they_are_those_that_were_sent(network, codec: str, parts: bool) -> None:
    settings = StreamSettings(codec=codec, framing="parts:3")
    sent = list(frames_of(Loop(TURNS).packets(), Loop(TURNS).sensor, "parts:3" if parts else "revolution"))
    with (
        live(network, newest=False, until_end=True, parts=parts) as stream,
        publisher(network, TURNS, settings, rate="max") as sending,
    ):
        came = [stream.next(60) for _ in sent]
        assert sending.wait(60)
    for frame, original in zip(came, sent, strict=True):
        assert frame is not None
        for name in ("range", "intensity", "azimuth"):
            np.testing.assert_array_equal(getattr(frame, name), getattr(original, name))
        assert frame.part == original.part


def test_a_slot_keeps_the_rest_of_what_was_begun_and_the_newest_turn() -> None:
    slot = Mailbox[str](goes_on=str.islower)
    for item in ("A", "b", "c"):
        slot.put(item)
    assert slot.take(0) == "A"
    for item in ("D", "e", "F", "g"):
        slot.put(item)
    assert [slot.take(0) for _ in range(5)] == ["b", "c", "F", "g", None]
    assert slot.replaced == 2


def test_parts_do_not_wait_for_a_slow_decoder_but_the_next_turn_does() -> None:
    slot = Mailbox[str](goes_on=str.islower)
    assert slot.put_wait("A", 0)
    for _ in range(MAX_PARTS - 1):
        assert slot.put_wait("b", 0)
    assert not slot.put_wait("b", 0)  # bounded, whatever comes
    assert slot.take(0) == "A"
    assert not slot.put_wait("C", 0)


def message(index: int, *, goes_on: bool) -> bytes:
    """As much of a message as an inbox looks at."""
    return struct.pack("<14xH40xI", 0x200 * goes_on, index)


def test_an_inbox_gives_all_parts_of_a_turn_and_else_the_newest(network) -> None:
    with network.end() as near, network.end() as far:
        inbox, sender = TurnInbox(near.inbox("a/frame", DEPTH)), far.sender("a/frame", Priority.FRAMES)
        sent = deque([message(0, goes_on=False), message(1, goes_on=True), message(2, goes_on=True)])
        for data in sent:
            sender.put(data)
        assert inbox.receive() == sent[0]
        turns = [message(index, goes_on=index % 3 > 0) for index in range(3, 9)]
        for data in turns:
            sender.put(data)
        assert [inbox.receive() for _ in range(5)] == [sent[1], sent[2], *turns[3:]]
        for index in range(20):
            sender.put(message(index, goes_on=False))
        assert inbox.receive() == message(19, goes_on=False)


def test_what_waits_in_an_inbox_has_a_limit_of_bytes(network, monkeypatch) -> None:
    """Parts of 60 MB that come faster than they are decoded would take a gigabyte."""
    parts = [message(index, goes_on=index > 0) for index in range(6)]
    monkeypatch.setattr(turn_inbox, "MAX_BYTES", 2 * len(parts[0]))
    with network.end() as near, network.end() as far:
        inbox, sender = TurnInbox(near.inbox("a/frame", DEPTH)), far.sender("a/frame", Priority.FRAMES)
        for data in parts:
            sender.put(data)
        assert [inbox.receive() for _ in range(2)] == parts[4:]


def test_a_turn_waits_for_the_last_part_of_the_one_before() -> None:
    """Else parts would queue up in a slow path."""
    flight = Flight(clock=lambda: 1.0)
    flight.came("office")
    assert flight.wait(0)
    for part in range(3):
        flight.sent(part, part, 1000, turn=0)
    for part in range(3):
        assert not flight.wait(0)
        flight.reported("office", part, part)
    assert flight.wait(0)


def test_a_turn_that_began_anew_can_be_referred_to_by_its_last_part() -> None:
    references = References()
    for index in range(3):
        references.sent(index, index - 1 if index else None, goes_on=index > 0)
    assert references.there() == {2}

"""The mailbox of one frame: newest wins, nothing vanishes uncounted, nobody waits for ever."""

from __future__ import annotations

import threading
import time

import pytest

from lidarcodec.apps.mailbox import Mailbox


def test_the_newest_wins_and_every_replaced_one_is_counted():
    mailbox = Mailbox()
    for number in range(10):
        assert mailbox.put(number)
    assert mailbox.take(0) == 9
    assert mailbox.take(0) is None
    assert mailbox.replaced == 9


def test_whoever_must_not_lose_anything_waits_for_the_slot():
    mailbox, got = Mailbox(), []

    def take():
        while (item := mailbox.take(60)) is not None:
            time.sleep(0.001)
            got.append(item)

    taker = threading.Thread(target=take)
    taker.start()
    for number in range(50):
        assert mailbox.put_wait(number, 60)
    mailbox.close()
    taker.join(60)
    assert got == list(range(50))
    assert mailbox.replaced == 0


def test_putting_in_time_or_not_at_all():
    mailbox = Mailbox()
    mailbox.put("first")
    start = time.monotonic()
    assert not mailbox.put_wait("second", 0.05)
    assert 0.04 < time.monotonic() - start < 20
    assert mailbox.take(0) == "first"


@pytest.mark.parametrize("wait", ["take", "put_wait"])
def test_closing_ends_every_wait(wait):
    mailbox, ended = Mailbox(), []
    if wait == "put_wait":
        mailbox.put("there")
    call = (lambda: mailbox.take(600)) if wait == "take" else (lambda: mailbox.put_wait("more", 600))
    thread = threading.Thread(target=lambda: ended.append(call()))
    thread.start()
    time.sleep(0.05)
    mailbox.close()
    thread.join(60)
    assert ended == [None if wait == "take" else False]


def test_what_was_in_it_at_close_can_still_be_taken():
    mailbox = Mailbox()
    mailbox.put("last")
    mailbox.close()
    assert not mailbox.finished
    assert not mailbox.put("late")
    assert mailbox.take(0) == "last"
    assert mailbox.finished


def test_producers_and_takers_at_full_speed_account_for_every_item():
    mailbox, taken = Mailbox(), 0

    def produce():
        for number in range(20_000):
            mailbox.put(number)
        mailbox.close()

    producer = threading.Thread(target=produce)
    producer.start()
    last = -1
    while not mailbox.finished:
        item = mailbox.take(1)
        if item is not None:
            assert item > last
            last, taken = item, taken + 1
    producer.join(60)
    assert last == 19_999
    assert taken + mailbox.replaced == 20_000

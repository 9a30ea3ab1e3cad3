"""What every transport promises; over memory and over Zenoh, so that what is tested in memory holds on the network."""

from __future__ import annotations

import threading
import time

import pytest

from lidarcodec.errors import TransportError
from lidarcodec.transport.base import MAX_EVENT_BYTES, Priority


def eventually(condition, limit_s=60.0):
    """Wait until the condition holds. What takes long to ask is asked less often, lest it hold up what is awaited."""
    end = time.monotonic() + limit_s
    while (asked := time.monotonic()) < end:
        if condition():
            return True
        time.sleep(min(max(0.005, 2 * (time.monotonic() - asked)), 0.1))
    return False


def comes(sender, data, arrived):
    """Whether a message arrives; sent again until then.

    A link has one message of a priority under way. One that follows while the machine has no time for it is dropped.
    """
    return eventually(lambda: sender.put(data) or arrived())


def test_bytes_put_on_a_key_arrive_as_they_were(network):
    car, office = network(), network()
    inbox = office.inbox("s/frame")
    sender = car.sender("s/frame", Priority.FRAMES)
    assert eventually(lambda: sender.matching)
    messages, came = (b"", b"x", bytes(range(256)) * 600), []
    for data in messages:
        assert comes(sender, data, lambda data=data: came.append(inbox.receive_now()) or came[-1] == data)
    assert set(came) - {None} == set(messages)
    assert inbox.receive_now() in (None, messages[-1]), "nothing else came; the last one may have come twice"


def test_a_slow_receiver_gets_the_newest_and_never_a_backlog(network):
    car, office = network(), network()
    inbox = office.inbox("s/frame")
    heard = []
    office.listen("s/frame", lambda key, data: heard.append(data))
    sender = car.sender("s/frame", Priority.FRAMES)
    assert eventually(lambda: sender.matching)
    for number in range(50):
        sender.put(b"%d" % number)
        time.sleep(0.002)
    assert comes(sender, b"49", lambda: heard.count(b"49") > 1), "so the first of the two is in the inbox, too"
    assert inbox.receive() == b"49"


def test_nobody_receives_what_they_sent_themselves(network):
    car, office = network(), network()
    own, other = car.inbox("s/frame"), office.inbox("s/frame")
    heard = []
    car.listen("s/**", lambda key, data: heard.append(data))
    sender = car.sender("s/frame", Priority.FRAMES)
    assert eventually(lambda: sender.matching)
    assert comes(sender, b"mine", lambda: other.receive_now() == b"mine")
    got = []
    thread = threading.Thread(target=lambda: got.append(own.receive()))
    thread.start()
    time.sleep(0.2)
    assert not got
    assert not heard
    own.close()
    thread.join(60)
    assert got == [None]


def test_closing_ends_a_receive_that_waits(network):
    for close_transport in (False, True):
        one = network()
        inbox, got = one.inbox("s/frame"), []
        thread = threading.Thread(target=lambda inbox=inbox, got=got: got.append(inbox.receive()))
        thread.start()
        time.sleep(0.05)
        (one if close_transport else inbox).close()
        thread.join(60)
        assert got == [None]
        one.close()


def test_a_publisher_knows_whether_anybody_receives(network):
    car, office = network(), network()
    told = []
    sender = car.sender("s/frame", Priority.FRAMES, told.append)
    assert not sender.matching
    inbox = office.inbox("s/frame")
    assert eventually(lambda: told == [True])
    assert sender.matching
    inbox.close()
    assert eventually(lambda: told == [True, False])
    assert not sender.matching
    sender.close()


def test_small_events_reach_a_listener_on_an_expression_with_their_keys(network):
    car, office = network(), network()
    heard = []
    listener = car.listen("s/arrived/*", lambda key, data: heard.append((key, data)))
    for name in ("a", "b"):
        sender = office.sender(f"s/arrived/{name}", Priority.REAL_TIME)
        assert eventually(lambda sender=sender: sender.matching)
        event = (f"s/arrived/{name}", name.encode())
        assert comes(sender, event[1], lambda event=event: event in heard), heard
    assert set(heard) == {("s/arrived/a", b"a"), ("s/arrived/b", b"b")}
    listener.close()


def test_an_event_beyond_the_limit_is_dropped_and_a_handler_that_fails_does_not_stop_the_rest(network, caplog):
    car, office = network(), network()
    heard = []

    def fragile(key, data):
        if data == b"bad":
            raise ValueError(data)
        heard.append(data)

    car.listen("s/report", fragile)
    sender = office.sender("s/report", Priority.STATUS)
    assert eventually(lambda: sender.matching)

    def said():
        return [r.levelname for r in caplog.records if r.name.startswith("lidarcodec")]

    assert comes(sender, bytes(MAX_EVENT_BYTES + 1), lambda: said() == ["WARNING"])
    assert comes(sender, b"bad", lambda: said() == ["WARNING", "ERROR"])
    sender.put(b"bad")
    assert comes(sender, b"good", lambda: heard)
    assert set(heard) == {b"good"}
    assert said() == ["WARNING", "ERROR"]


def test_long_events_on_ever_new_keys_are_said_once(network, caplog):
    """Who sends chooses the key: a line for each would fill the log, and a note of each the memory."""
    car, office = network(), network()
    heard = []
    car.listen("s/arrived/*", lambda key, data: heard.append(data))
    for number in range(5):
        sender = office.sender(f"s/arrived/{number}", Priority.STATUS)
        assert eventually(lambda sender=sender: sender.matching)
        for _ in range(3):
            sender.put(bytes(MAX_EVENT_BYTES + 1))
            time.sleep(0.02)
    assert comes(sender, b"good", lambda: heard)
    assert set(heard) == {b"good"}
    assert [r.levelname for r in caplog.records if r.name.startswith("lidarcodec")] == ["WARNING"]


def test_a_query_is_answered_and_one_that_is_not_ends_without_waiting(network):
    car, office = network(), network()
    answering = car.answer("s/control/get", lambda data: b"you said " + data)
    car.answer("s/control/bad", lambda data: 1 / 0)
    assert eventually(lambda: office.ask("s/control/get", b"hello") == b"you said hello")
    for key in ("s/control/bad", "s/control/nobody"):
        start = time.monotonic()
        assert office.ask(key, timeout_s=60.0) is None
        assert time.monotonic() - start < 20.0
    answering.close()
    assert eventually(lambda: office.ask("s/control/get") is None)


def test_a_watcher_sees_who_is_there_who_comes_and_who_goes(network):
    car, office = network(), network()
    first = car.token("s/a/alive")
    seen = []
    office.watch("s/*/alive", lambda key, alive: seen.append((key, alive)))
    assert eventually(lambda: seen == [("s/a/alive", True)])
    second = car.token("s/b/alive")
    assert eventually(lambda: ("s/b/alive", True) in seen)
    second.close()
    assert eventually(lambda: ("s/b/alive", False) in seen)
    first.close()
    assert eventually(lambda: ("s/a/alive", False) in seen)
    office.token("s/own/alive")
    assert eventually(lambda: ("s/own/alive", True) in seen)


def test_after_close_everything_says_so_and_nothing_is_left(network):
    one = network()
    before = set(threading.enumerate())
    sender = one.sender("s/frame", Priority.FRAMES, lambda matching: None)
    one.listen("s/x", lambda key, data: None)
    one.answer("s/y", lambda data: data)
    one.watch("s/*/alive", lambda key, alive: None)
    one.close()
    one.close()
    sender.close()
    with pytest.raises(TransportError):
        sender.put(b"late")
    with pytest.raises(TransportError):
        one.inbox("s/frame")
    with pytest.raises(TransportError):
        one.token("s/alive")
    assert eventually(lambda: set(threading.enumerate()) <= before)


def test_every_session_has_a_name_of_its_own(network):
    names = [network().identity for _ in range(3)]
    assert len(set(names)) == 3
    assert all(0 < len(name) <= 32 and int(name, 16) for name in names)


def test_what_is_attached_for_others_changes_nothing_for_us(network):
    near, far = network(), network()
    inbox = far.inbox("s/frame")
    sender = near.sender("s/frame", Priority.FRAMES)
    assert eventually(lambda: sender.matching)
    assert eventually(lambda: sender.put(b"points", b"beside") or inbox.receive_now() == b"points")


@pytest.mark.parametrize("key", ["", "/a", "a//b", "a/", "a/*", "a/b*", "a?b", "a/$*"])
def test_a_key_that_is_none_is_refused(network, key):
    one = network()
    with pytest.raises(TransportError):
        one.sender(key, Priority.STATUS)


def test_queries_on_all_keys_under_one_are_answered_and_others_are_left(network):
    office, car = network(), network()
    office.answer_under("s/@maps/**", lambda key, data: None if "other" in key else key.encode() + data)
    assert eventually(lambda: car.ask("s/@maps/town/3/-2", b"!") == b"s/@maps/town/3/-2!")
    assert car.ask("s/@maps", b"", 20.0) == b"s/@maps"
    begun_s = time.monotonic()
    assert car.ask("s/@maps/other", b"", 60.0) is None
    assert time.monotonic() - begun_s < 20.0
    assert office.ask("s/@maps/town", b"", 0.2) is None
    with pytest.raises(TransportError, match="wildcards"):
        car.ask("s/@maps/*")


def test_all_answers_come_when_all_are_asked(network):
    first, second, car = network(), network(), network()
    first.answer_under("s/@maps/**", lambda key, data: b"first")
    second.answer("s/@maps", lambda data: b"second")
    assert eventually(lambda: sorted(car.ask_all("s/@maps")) == [b"first", b"second"])
    assert car.ask_all("s/nobody", b"", 0.2) == []

"""Who takes many live sockets leaves room for others: for operators, for other clients, for other hosts."""

from __future__ import annotations

import contextlib

import pytest

from lidarcodec_server.live.seats import SILENT_S, Seat, Seats, TooManyViewersError


class Room(Seats):
    """Remembers who had to give way."""

    def __init__(self, *limits, **options):
        super().__init__(*limits, **options)
        self.ended = []

    def come(self, client, host="10.0.0.1", operator=False, silent_s=0.0):
        seat = Seat(client, host, operator, lambda: silent_s)
        seat.end = lambda: self.ended.append(client)
        return self.take(seat)


def test_two_viewers_with_all_they_may_have_leave_room_for_operators_and_other_viewers():
    room = Room(64, 32, 64)
    for name in ("anna", "bert"):
        for _ in range(40):
            with contextlib.suppress(TooManyViewersError):
                room.come(name)
    assert len(room) == 56
    room.ended.clear()
    for _ in range(8):
        room.come("ada", operator=True)
    assert not room.ended
    room.come("carl")
    room.come("ada", operator=True)
    assert sorted(room.ended) == ["anna", "bert"], "the client with the most gives way, each time"
    assert len(room) == 64


def test_a_socket_whose_stream_is_silent_gives_way_first():
    room = Room(3, 2, 3)
    for name, silent_s in (("anna", 5.0), ("bert", SILENT_S + 1), ("carl", SILENT_S + 5)):
        room.come(name, operator=True, silent_s=silent_s)
    room.come("dora", operator=True)
    room.come("ella", operator=True)
    assert room.ended == ["carl", "bert"]
    with pytest.raises(TooManyViewersError) as caught:
        room.come("emil", operator=True, host="10.0.0.9")
    assert not caught.value.own, "nobody has clearly more than another, and nobody's stream is silent"


def test_a_host_has_so_many_with_however_many_tokens_and_a_proxy_is_no_host():
    room = Room(64, 32, 4)
    for number in range(4):
        room.come(f"token {number}")
    with pytest.raises(TooManyViewersError, match=r"10\.0\.0\.1 has 4"):
        room.come("token 5")
    room.come("another", host="10.0.0.2")
    behind = Room(64, 32, 4, proxies=["10.0.0.1"])
    for number in range(20):
        behind.come(f"token {number}")
    assert len(behind) == 20


def test_who_leaves_twice_leaves_once():
    room = Room(1, 1, 1)
    seat = room.come("anna", operator=True)
    room.leave(seat)
    room.leave(seat)
    room.come("bert", operator=True)
    assert (len(room), room.of("bert")) == (1, 1)

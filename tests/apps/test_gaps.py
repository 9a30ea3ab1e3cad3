"""What is fetched goes between live messages: never before one that is due, and not as if the link were still busy."""

from __future__ import annotations

import pytest

from lidarcodec.apps.publisher.gaps import LEAST, Gaps

BYTE_S = 2e-6
"""A link of 4 Mbit/s: a message of 20 kB takes 40 ms."""
WANTED = 64_000


@pytest.fixture
def gaps() -> Gaps:
    """A stream of 10 Hz whose last message was sent at 0.9 s."""
    gaps = Gaps()
    for number in range(10):
        gaps.message(0.1 * number, 20_000)
        gaps.arrived(0.1 * number + 0.04, BYTE_S, free=True)
    return gaps


def test_a_part_ends_before_the_next_message_is_due(gaps: Gaps) -> None:
    wait_s, size = gaps.room(0.95, WANTED, busy=False, rtt_s=0.001) or (0.0, 0)
    assert wait_s == 0.0
    assert LEAST < size <= 0.05 / BYTE_S
    again = gaps.room(0.96, WANTED, busy=False, rtt_s=0.05)
    assert again is not None
    assert again[1] == 0  # that part fills the gap
    assert again[0] == pytest.approx(0.04, abs=0.01)


def test_on_a_short_path_a_part_waits_for_the_report_of_the_message(gaps: Gaps) -> None:
    gaps.message(1.0, 20_000)
    assert (gaps.room(1.045, WANTED, busy=True, rtt_s=0.001) or (0, 1))[1] == 0
    gaps.arrived(1.045, BYTE_S, free=True)
    assert (gaps.room(1.045, WANTED, busy=False, rtt_s=0.001) or (0, 0))[1] > LEAST


def test_on_a_short_path_small_parts_go_until_the_next_message_is_there(gaps: Gaps) -> None:
    assert gaps.room(0.99, WANTED, busy=False, rtt_s=0.001, least=4096) == (0.0, 4096)
    assert (gaps.room(0.99, WANTED, busy=False, rtt_s=0.05, least=4096) or (0, 1))[1] == 0


def test_on_a_long_path_a_part_goes_when_the_link_is_free_although_the_report_is_on_its_way(gaps: Gaps) -> None:
    gaps.message(1.0, 20_000)
    wait_s, size = gaps.room(1.02, WANTED, busy=True, rtt_s=0.05) or (0.0, 1)
    assert (round(wait_s, 3), size) == (0.02, 0)
    assert (gaps.room(1.041, WANTED, busy=True, rtt_s=0.05) or (0, 0))[1] > LEAST


def test_on_a_long_path_a_late_report_holds_parts_back(gaps: Gaps) -> None:
    gaps.message(1.0, 5_000)  # 10 ms, and the report is there after 60
    assert (gaps.room(1.085, WANTED, busy=True, rtt_s=0.05) or (0, 1))[1] == 0


def test_small_ends_of_pieces_go_into_small_gaps_and_others_do_not(gaps: Gaps) -> None:
    assert (gaps.room(0.99, WANTED, busy=False, rtt_s=0.001) or (0, 1))[1] == 0
    assert gaps.room(0.99, 500, busy=False, rtt_s=0.001) == (0.0, 500)


def test_nothing_is_known_before_the_stream_and_after_its_end(gaps: Gaps) -> None:
    assert Gaps().room(0.0, WANTED, busy=False, rtt_s=0.0) is None
    assert gaps.room(2.0, WANTED, busy=False, rtt_s=0.0) is None

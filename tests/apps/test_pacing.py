"""When refinements are sent: never so that the next message comes later than it would alone, and not more rarely."""

from __future__ import annotations

import pytest

from lidarcodec.apps.publisher.pacing import ALONE_EVERY, Pacing

SIZE, SECTOR = 20_000, 5_000
BYTE_S = 2e-6
"""A link of 4 Mbit/s: a message takes 40 ms, a sector 10 ms."""


class Link:
    """A stream of 10 Hz over a link, as it tells a Pacing of it.

    later_s: how much later a message comes after sectors that ended less than `rest_s` before it
    """

    def __init__(self, later_s: float = 0.0, rest_s: float = 0.0) -> None:
        self.pacing, self._later_s, self._rest_s = Pacing(), later_s, rest_s
        self.sent: list[int] = []
        self._number, self._end_s = 0, float("-inf")

    def frame(self) -> None:
        """A message, and the sectors for which there is room behind it."""
        now_s = 0.1 * self._number
        self.pacing.message(now_s, SIZE)
        late = self._later_s if now_s - self._end_s < self._rest_s else 0.0
        beside = bool(self.sent and self.sent[-1])
        self.pacing.message_took(SIZE * BYTE_S + late, SIZE, BYTE_S, beside=beside)
        self._number += 1
        now_s += SIZE * BYTE_S + late
        self.pacing.idle(now_s)
        count = 0
        while not self.pacing.alone and count < 12 and self.pacing.fits(now_s, SECTOR):
            self.pacing.sector(now_s, SECTOR)
            begin_s, now_s = now_s, now_s + SECTOR * BYTE_S
            self.pacing.sector_took(now_s, begin_s, SECTOR, 0.0)
            self.pacing.idle(now_s)
            self._end_s, count = now_s, count + 1
        if not count:
            self.pacing.nothing_fitted()
        self.sent.append(count)


def test_a_link_that_needs_no_rest_is_used_to_the_end():
    link = Link()
    for _ in range(400):
        link.frame()
    assert sum(link.sent[:10]) < sum(link.sent[-10:])
    assert max(link.sent[-2 * ALONE_EVERY :]) >= 5  # 60 ms are free, a sector takes 10
    assert link.sent[-2 * ALONE_EVERY :].count(0) == 2  # those that show how long a message takes alone


def test_a_link_whose_messages_come_later_after_sectors_gets_the_rest_that_they_need():
    link = Link(later_s=0.02, rest_s=0.025)
    late = []
    for _ in range(600):
        before_s = link._end_s
        link.frame()
        late.append(0.1 * (link._number - 1) - before_s < 0.025)
    assert sum(late[-200:]) < 0.3 * 200
    assert sum(link.sent[-200:]) > 200  # and it is used all the same


def test_a_link_with_room_for_everything_has_no_frame_without_sectors():
    pacing = Pacing()
    for number in range(50):
        pacing.message(0.1 * number, 1000)
        pacing.message_took(0.002, 1000, BYTE_S, beside=True)
        assert not pacing.alone
        assert pacing.fits(0.1 * number + 0.002, SECTOR)
        pacing.sector(0.1 * number + 0.002, SECTOR)
        pacing.sector_took(0.1 * number + 0.012, 0.1 * number + 0.002, SECTOR, 0.0)


def test_a_sector_that_took_long_is_tried_again_when_it_may_be_faster():
    pacing = Pacing()
    pacing.message(0.0, SIZE)
    pacing.message(0.1, SIZE)
    pacing.sector_took(0.5, 0.1, SECTOR, 0.0)
    assert not pacing.fits(0.14, SECTOR)
    frames = 0
    while not pacing.fits(0.1 * (frames + 1) + 0.001, SECTOR):
        frames += 1
        pacing.message(0.1 * (frames + 1), SIZE)
        pacing.nothing_fitted()
        assert frames < 100
    assert frames > 8


def test_sectors_that_nobody_reports_are_sent_seldom():
    pacing, sent = Pacing(), 0
    for number in range(200):
        now_s = 0.1 * number
        pacing.message(now_s, SIZE)
        pacing.idle(now_s)
        if pacing.fits(now_s, SECTOR):
            pacing.sector(now_s, SECTOR)
            pacing.sectors_lost(now_s + 0.1, now_s, SECTOR)
            sent += 1
        else:
            pacing.nothing_fitted()
    assert 1 <= sent <= 10


def settled() -> Link:
    link = Link()
    for _ in range(50):
        link.frame()
    return link


def frames_until_refined(link: Link) -> int:
    """How many frames go without a sector before the next with one."""
    for frames in range(300):
        link.frame()
        if link.sent[-1]:
            return frames
    raise AssertionError("never refined again")


@pytest.mark.parametrize("away_s", [0.2, 60.0, 3600.0])
@pytest.mark.parametrize("lost", [1, 5])
def test_after_a_cut_frames_are_refined_again_soon(away_s, lost):
    link = settled()
    now_s = 0.1 * link._number - 0.01
    link.pacing.sector(now_s, SECTOR)
    link._number += round(10 * away_s)
    link.pacing.message(0.1 * link._number, SIZE)
    for _ in range(1 if away_s > 1.0 else lost):  # frames in a row
        link.pacing.sectors_lost(0.1 * link._number, now_s, SECTOR)
        link._number += 1
    assert frames_until_refined(link) <= (1 if away_s > 1.0 else 20 if lost == 1 else 45)


def test_a_pause_of_the_sensor_does_not_change_when_messages_are_due():
    link = settled()
    link._number += 600
    for _ in range(4):
        link.frame()
    assert max(link.sent[-3:]) >= 3
    assert not link.pacing.fits(0.1 * link._number - 0.005, SECTOR)


def test_a_stream_of_few_messages_is_no_stream_of_pauses():
    pacing = Pacing()
    for number in range(3):
        pacing.message(0.1 * number, SIZE)
        pacing.message_took(SIZE * BYTE_S, SIZE, BYTE_S, beside=False)
    for number in range(1, 6):
        pacing.message(5.0 * number, SIZE)
    assert pacing.fits(25.0 + 4.0, SECTOR)
    assert not pacing.fits(25.0 + 4.995, SECTOR)
    for number in range(4):  # and fast again
        pacing.message(26.0 + 0.1 * number, SIZE)
    assert pacing.fits(26.34, SECTOR)
    assert not pacing.fits(26.395, SECTOR)


def test_a_new_path_has_to_be_learned_and_messages_are_due_as_before():
    link = settled()
    now_s = 0.1 * link._number - 0.1
    link.pacing.sector_took(now_s + 0.5, now_s, SECTOR, 0.0)
    assert not link.pacing.fits(now_s + 0.02, SECTOR)
    link.pacing.new_path()
    assert link.pacing.fits(now_s + 0.02, SECTOR)
    assert not link.pacing.fits(now_s + 0.1, SECTOR)

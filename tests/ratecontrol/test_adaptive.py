"""The estimator alone, on simulated paths and on what a real one said: quality follows the path, and never lags."""

from __future__ import annotations

import json
import math
from itertools import pairwise
from pathlib import Path as File

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lidarcodec.ratecontrol.adaptive import (
    MAX_KBPS,
    MIN_KBPS,
    SHARE,
    START_KBPS,
    Landing,
    PathState,
    adapted,
    capacity_kbps,
    elsewhere,
    target_kbps,
)
from tests.ratecontrol.path import Path, late_s, sent_kbps, stream

TRACE = File(__file__).parent / "landings.json"


def cut(t: float) -> float:
    """20, then 4, then 20 Mbit/s."""
    return 4_000.0 if 10.0 <= t < 20.0 else 20_000.0


@pytest.mark.parametrize("rtt_s", [0.0, 0.03, 0.1])
@pytest.mark.parametrize("bucket_bits", [0.0, 128e3])
@pytest.mark.parametrize("jitter_s", [0.0, 0.005])
def test_a_cut_is_followed_within_two_seconds_and_the_rate_is_back_within_ten(rtt_s, bucket_bits, jitter_s):
    shown = stream(Path(cut, rtt_s, bucket_bits), 32.0, jitter_s=jitter_s, window=1 + round(rtt_s / 0.065))
    assert late_s(shown, 2.0, 10.0) < 0.2
    assert late_s(shown, 12.0, 20.0) < 0.2
    assert late_s(shown, 22.0, 32.0) < 0.2
    before, after = sent_kbps(shown, 4.0, 10.0), sent_kbps(shown, 30.0, 32.0)
    assert before > 0.4 * 20_000, "quality is not given away"
    assert after > 0.9 * before
    assert 0.4 * 4_000 < sent_kbps(shown, 13.0, 20.0) < 4_000


@pytest.mark.parametrize("kbps", [300, 1000, 5000, 25_000, 100_000])
def test_any_path_is_found_within_two_seconds_and_has_room_to_spare(kbps):
    shown = stream(Path(lambda t: kbps), 10.0)
    assert late_s(shown, 2.0, 10.0) < 0.15
    assert 0.45 * kbps < sent_kbps(shown, 2.0, 10.0) < 0.8 * kbps


def test_a_path_that_is_much_faster_than_the_codec_ever_sends_is_not_sounded_out():
    """On a machine's own loopback the codec's finest is reached within a second, and stays."""
    shown = stream(Path(lambda t: 1e6), 5.0, most_bits=1.3e6)
    assert min(one.bits for one in shown if one.at_s > 1.0) == 1.3e6


def test_several_in_flight_are_not_taken_for_a_slow_path():
    """With a round trip of 0.2 s three or four are under way at once; the path is as fast as before."""
    shown = stream(Path(lambda t: 10_000, 0.2), 12.0, window=4)
    assert 0.45 * 10_000 < sent_kbps(shown, 4.0, 12.0) < 8_000
    assert late_s(shown, 3.0, 12.0) < 0.3


def test_a_round_trip_that_grew_unnoticed_does_not_take_the_quality_down_to_nothing():
    """Another cell, another route: 0.1 s more, and until it has been measured all of it looks like slow sending."""
    path = Path(lambda t: 10_000, 0.02, unknown_s=lambda t: 0.1 if t > 5.0 else 0.0)
    shown = stream(path, 20.0)
    assert sent_kbps(shown, 10.0, 20.0) > 0.15 * 10_000
    assert late_s(shown, 7.0, 20.0) < 0.25


def test_key_frames_that_are_much_larger_do_not_lag_either():
    shown = stream(Path(lambda t: 5_000), 20.0, key_every=10, key_factor=4.0)
    assert max(one.late_s for one in shown if one.at_s > 5.0) < 0.3
    assert late_s(shown, 5.0, 20.0) < 0.2


def test_a_codec_whose_coarsest_is_too_much_loses_frames_and_not_seconds():
    shown = stream(Path(lambda t: 2_000), 20.0, least_bits=400e3)
    per_second = sum(10.0 <= one.at_s < 20.0 for one in shown) / 10.0
    assert per_second == pytest.approx(5.0, abs=0.8)
    assert late_s(shown, 2.0, 20.0) < 0.2 + 0.1 + 0.03


def test_a_bucket_of_tokens_is_not_filled_and_hit_again_and_again():
    """Half a second of the path's rate goes through at once; then it stands until that has been made up for."""
    shown = stream(Path(lambda t: 4_000, 0.0, 2e6), 60.0)
    slow = [one for one in shown if one.at_s > 10.0 and one.late_s > 0.3]
    assert len(slow) < 0.03 * len(shown)
    assert sent_kbps(shown, 20.0, 60.0) < 4_100


def test_a_path_that_stands_still_gets_the_least_and_comes_back():
    shown = stream(Path(lambda t: 0.0 if 5.0 <= t < 9.0 else 8_000.0), 25.0)
    assert late_s(shown, 12.0, 25.0) < 0.2
    assert sent_kbps(shown, 18.0, 25.0) > 0.45 * 8_000


def test_what_a_real_link_said_gives_what_it_carried():
    """Recorded between namespaces at 20, 4 and 20 Mbit/s: (kbit/s of the link, seconds since its last change, ...)."""
    state, found = PathState(), []
    for link_kbps, since_change_s, *landing in json.loads(TRACE.read_text()):
        state, target = adapted(state, Landing(*landing))
        if since_change_s > 2.0 and (found or link_kbps == 4_000 or since_change_s > 8.0):
            found.append((link_kbps, capacity_kbps(state), target))
    assert len(found) > 100
    for link_kbps, capacity, target in found:
        assert 0.6 * link_kbps < capacity < 1.6 * link_kbps
        assert target < 1.05 * link_kbps


def test_another_receiver_is_measured_afresh_and_the_first_message_counts_whole():
    state, _ = adapted(PathState(), Landing(1e6, 0.02, 0.1))
    assert capacity_kbps(state) == pytest.approx(50_000)
    state = elsewhere(state)
    assert target_kbps(state) == pytest.approx(SHARE * 50_000), "until it is known better"
    state, target = adapted(state, Landing(1e6, 0.5, 0.1))
    assert target == pytest.approx(SHARE * 2_000)


def test_before_anything_arrived_it_begins_carefully():
    assert target_kbps(PathState()) == START_KBPS
    assert capacity_kbps(PathState()) is None


def test_small_messages_that_tell_nothing_take_nothing_away():
    """A scene without returns: a message of 200 bytes in the noise of the clock says nothing against the path."""
    state, _ = adapted(PathState(), Landing(1e6, 0.05, 0.1))
    for _ in range(50):
        state, target = adapted(state, Landing(1600, 0.002, 0.1, 0.001))
    assert target == pytest.approx(SHARE * 20_000)


def test_messages_without_bits_tell_no_rate():
    """Two late ones in a row ended the controller with a division by zero."""
    state = PathState()
    given_up = Landing(0.0, 0.0, 0.0, landed=False)
    for landing in [given_up, given_up, Landing(1.0, 0.0, 0.0), Landing(0.0, 1.0, 0.0), Landing(0.0, 1.0, 0.0)]:
        state, target = adapted(state, landing)
    assert MIN_KBPS <= target <= MAX_KBPS


SECONDS, BITS, COUNT = st.floats(-10.0, 100.0), st.floats(0, 1e10), st.integers(0, 1000)
LANDING = st.builds(Landing, BITS, SECONDS, SECONDS, st.floats(0, 10.0), st.booleans(), COUNT, st.booleans())


@given(st.lists(LANDING, max_size=60))
def test_whatever_is_measured_the_target_stays_sane(landings):
    state = PathState()
    targets = []
    for landing in landings:
        state, target = adapted(state, landing)
        assert MIN_KBPS <= target <= MAX_KBPS
        assert math.isfinite(capacity_kbps(state) or 0.0)
        targets.append(target)
    again = PathState()
    for landing, target in zip(landings, targets, strict=True):
        again, same = adapted(again, landing)
        assert same == target


def test_one_lost_message_costs_a_second_and_not_the_quality_of_the_next_twenty():
    state, before = adapted(PathState(), Landing(4e5, 0.05, 0.1))
    state, stalled = adapted(state, Landing(4e5, 1.0, 1.0, landed=False))
    assert stalled < 0.1 * before
    state, _ = adapted(state, Landing(3e4, 0.6, 0.6))
    for _ in range(5):
        state, after = adapted(state, Landing(3e4, 0.00375, 0.1))
    assert after > 0.8 * before


def test_after_a_cut_the_rate_doubles_in_a_second_at_most():
    state, _ = adapted(PathState(), Landing(1e6, 0.1, 0.1))
    for _ in range(4):
        state, _ = adapted(state, Landing(1e6, 1.0, 0.1))
    targets = []
    for _ in range(40):
        state, target = adapted(state, Landing(1e5, 0.001, 0.1))
        targets.append(target)
    assert all(late / early <= 2.1 for early, late in pairwise(targets[9::10]))

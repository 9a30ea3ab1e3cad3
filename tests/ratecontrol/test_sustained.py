"""Links that pass a burst at once, as mobile networks do: a picture that stays as it is, and frames in time."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from lidarcodec.ratecontrol.adaptive import SHARE, Landing, PathState, adapted, sustained_kbps, while_waiting
from lidarcodec.ratecontrol.sustained import UNLIMITED, USED, after
from tests.ratecontrol.path import Path, Shown, late_s, sent_kbps, stream

DRILL = ((20_000.0, 10.0), (4_000.0, 22.0), (1_000.0, 34.0), (400.0, 48.0), (20_000.0, 62.0))
"""Kbit/s, and until when: the link of `python -m benchmarks.adaptive`."""


def drill(t: float) -> float:
    return next((kbps for kbps, until in DRILL if t < until), DRILL[-1][0])


def parts(shown: list[Shown]) -> dict[float, list[Shown]]:
    """Frames of the narrow parts, without the first two seconds of each."""
    return {
        kbps: [one for one in shown if begin + 2.0 <= one.at_s < end]
        for (_, begin), (kbps, end) in pairwise(DRILL[:-1])
    }


@pytest.mark.parametrize("bucket_bits", [64e3, 128e3, 512e3])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_frames_are_in_time_and_the_rate_is_steady_whatever_the_bucket_holds(bucket_bits, seed):
    shown = stream(Path(drill, 0.001, bucket_bits), 62.0, stale=1, seed=seed)
    for kbps, frames in parts(shown).items():
        late = np.array([one.late_s for one in frames])
        assert np.median(late) < 0.1
        assert np.quantile(late, 0.95) < (0.17 if bucket_bits < 5e5 else 0.26)
        assert 0.75 * kbps < sum(one.bits for one in frames) / (frames[-1].at_s - frames[0].at_s) / 1e3 < 1.1 * kbps
        if bucket_bits == 128e3:
            targets = np.array([one.target_kbps for one in frames])
            assert targets.std() < 0.35 * targets.mean(), "the picture does not pulse"


@pytest.mark.parametrize("bucket_bits", [64e3, 128e3, 512e3])
@pytest.mark.parametrize("waited_s", [14.0, 15.2, 16.4, 17.6])
def test_a_path_that_is_restored_is_used_again_within_five_and_a_half_seconds(bucket_bits, waited_s):
    """The limit may just have begun to be held. Until it rises, the operator sees the picture of the narrow path."""
    restored_s = 10.0 + waited_s
    shown = stream(Path(lambda t: 400.0 if 10.0 <= t < restored_s else 20e3, 0.001, bucket_bits), 32.0, stale=1)
    before = np.median([one.target_kbps for one in shown if 2.0 <= one.at_s < 10.0])
    back = (one.at_s for one in shown if one.at_s > restored_s and one.target_kbps >= 0.9 * before)
    assert next(back, math.inf) - restored_s < 5.5


def test_a_path_without_a_bucket_is_followed_as_if_nobody_knew_of_buckets():
    shown = stream(Path(drill, 0.001), 62.0, stale=1)
    for kbps, frames in parts(shown).items():
        assert np.quantile([one.late_s for one in frames], 0.95) < 0.12
        assert sent_kbps(shown, frames[0].at_s, frames[-1].at_s) > 0.55 * kbps
    assert late_s(shown, 50.0, 62.0) < 0.12
    assert sent_kbps(shown, 50.0, 62.0) > 0.55 * 20_000


def test_two_messages_that_empty_the_bucket_tell_the_rate_however_much_it_held():
    for bucket in (0.0, 3e4, 3e5):
        state = after(UNLIMITED, 1e5 + bucket, 0.1, 0.2, 2e7)
        state = after(state, 9e4, 0.06, 0.09, 3e6)  # 30 ms of its time the path was idle, and filled the bucket
        state = after(state, 1e5, 0.1, 0.1, 3e6)
        assert state.known_bps == pytest.approx(1e6)


def test_a_single_late_message_says_nothing_of_the_rate():
    """A busy receiver must not cost anybody the picture."""
    state = after(UNLIMITED, 1e5, 0.15, 0.15, 4e6)
    assert math.isinf(after(state, 1e5, 0.005, 0.1, 4e6).bps)


def test_the_target_stays_below_the_rate_that_was_measured_though_bursts_look_fast():
    state, _ = adapted(PathState(), Landing(1e5, 0.002, 0.1))
    for _ in range(8):
        state, target = adapted(state, Landing(1e5, 0.1, 0.1))
    for _ in range(10):
        state, target = adapted(state, Landing(0.85e5, 0.002, 0.1))
    assert sustained_kbps(state) == pytest.approx(1000.0)
    assert target == pytest.approx(USED * 1000.0)


def test_frames_behind_one_that_does_not_arrive_are_small_at_once():
    """A link that was cut to a tenth: each frame of the old size behind the first would wait a second more."""
    assert while_waiting(4000.0, None) == 4000.0
    assert while_waiting(4000.0, (50_000, 0.1)) == 4000.0, "usual, or lost and soon known as such"
    assert while_waiting(4000.0, (50_000, 0.5)) == pytest.approx(SHARE * 800.0)
    assert while_waiting(200.0, (50_000, 0.5)) == 200.0

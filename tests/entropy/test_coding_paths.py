"""What a user loses if these fail: frames that a car with one processor sends and a station with another misreads."""

from __future__ import annotations

import hashlib
from pathlib import Path

import pytest
from hypothesis import given, settings

from lidarcodec.entropy import PredictiveCoder, fast
from lidarcodec.errors import SettingsError
from tests.entropy.frames import all_fired, mask, one_in_three
from tests.entropy.test_mask_coder import golden_sensor
from tests.entropy.test_predictive_coder import LEVELS, SENSOR, cases, check_bound, golden_case, guess, scene

PATHS = fast.coding_paths()


def test_the_quickest_path_of_this_processor_is_used_and_others_can_be_asked_for() -> None:
    assert PATHS[0] == "plain"
    about = Path("/proc/cpuinfo")
    if about.exists():
        assert ("avx2" in PATHS) == (" avx2 " in about.read_text())
    with pytest.raises(SettingsError, match="plain"):
        PredictiveCoder("abacus")


@pytest.mark.parametrize("path", PATHS)
def test_every_path_gives_the_bytes_of_every_other_machine(path: str) -> None:
    ranges, returns, fired = golden_case()
    coder, digest = PredictiveCoder(path), hashlib.sha256()
    for step in (1, 11, 51):
        digest.update(coder.encode(ranges, returns, fired, golden_sensor(), step, LEVELS))
    assert digest.hexdigest() == "7b903d134eb4edbe86cb7aa41c3f38617c09cab0ad811d146c79d2a8a524caa5"


@pytest.mark.parametrize("path", PATHS[1:])
@settings(max_examples=60, deadline=None)
@given(case=cases())
def test_what_one_path_wrote_another_reads_and_would_have_written(path: str, case) -> None:
    ranges, returns, fired, of, step, levels, expected, firing = case
    given_to = (returns, fired, of, step, levels)
    plain, other = PredictiveCoder("plain"), PredictiveCoder(path)
    for _ in range(2):  # the second frame goes on from what the first one taught
        data = plain.encode(ranges, *given_to, expected=expected, firing=firing)
        assert data == other.encode(ranges, *given_to, expected=expected, firing=firing)
    for writer, reader in ((plain, PredictiveCoder(path)), (other, PredictiveCoder("plain"))):
        writer.reset()
        came = reader.decode(
            writer.encode(ranges, *given_to, expected=expected, firing=firing), *given_to, expected=expected
        )
        check_bound(came, ranges, returns, step)


@pytest.mark.parametrize("step", [1, 501])
@pytest.mark.parametrize("fired_of", [all_fired, one_in_three])
def test_whole_frames_are_the_same_on_all_paths(fired_of, step: int) -> None:
    fired, ranges = fired_of(2088), scene(2088)
    returns = mask(2088) & fired[(SENSOR.laser_of_ring >= 32).astype(int)]
    for expected in (None, guess(ranges)):
        coders = [PredictiveCoder(path) for path in PATHS]
        given_to = (returns, fired, SENSOR, step, LEVELS)
        data = {coder.encode(ranges, *given_to, expected=expected) for coder in coders}
        assert len(data) == 1
        for path in PATHS:
            came = PredictiveCoder(path).decode(*data, *given_to, expected=expected)
            check_bound(came, ranges, returns, step)

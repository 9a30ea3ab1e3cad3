"""What a user loses if these fail: frames that a car with one processor sends and a station with another misreads."""

from __future__ import annotations

import itertools
from pathlib import Path

import pytest
from hypothesis import given, settings

from lidarcodec.entropy import PredictiveCoder, fast
from lidarcodec.errors import SettingsError
from tests.entropy.frames import all_fired, mask, one_in_three
from tests.entropy.test_predictive_coder import (
    FREE_GOLDEN,
    GOLDEN,
    LEVELS,
    SENSOR,
    cases,
    check_bound,
    free_golden_digest,
    golden_digest,
    guess,
    scene,
)
from tests.sweeps import examples, spread

PATHS = fast.coding_paths()


def test_the_quickest_path_of_this_processor_is_used_and_others_can_be_asked_for() -> None:
    assert PATHS[0] == "plain"
    about = Path("/proc/cpuinfo")
    if about.exists():
        assert ("avx2" in PATHS) == (" avx2 " in about.read_text())
    with pytest.raises(SettingsError, match="plain"):
        PredictiveCoder("abacus")


@pytest.mark.parametrize("quick", [False, True])
@pytest.mark.parametrize("path", PATHS)
def test_every_path_gives_the_bytes_of_every_other_machine(path: str, quick: bool) -> None:
    assert golden_digest(path, quick) == GOLDEN[quick]


@pytest.mark.parametrize("path", PATHS)
def test_every_path_chooses_the_free_ranges_of_every_other_machine(path: str) -> None:
    assert free_golden_digest(path) == FREE_GOLDEN


@pytest.mark.parametrize("path", PATHS[1:])
@settings(max_examples=examples(60), deadline=None)
@given(case=cases())
def test_what_one_path_wrote_another_reads_and_would_have_written(path: str, case) -> None:
    ranges, returns, fired, of, step, levels, expected, firing, quick = case
    told = {"expected": expected, "firing": firing, "quick": quick}
    given_to = (returns, fired, of, step, levels)
    plain, other = PredictiveCoder("plain"), PredictiveCoder(path)
    for _ in range(2):  # the second frame goes on from what the first one taught
        data = plain.encode(ranges, *given_to, **told)
        assert data == other.encode(ranges, *given_to, **told)
    for writer, reader in ((plain, PredictiveCoder(path)), (other, PredictiveCoder("plain"))):
        writer.reset()
        came = reader.decode(writer.encode(ranges, *given_to, **told), *given_to, expected=expected)
        check_bound(came, ranges, returns, step)


@pytest.mark.parametrize(("fired_of", "step"), spread([all_fired, one_in_three], [1, 501]))
def test_whole_frames_are_the_same_on_all_paths(fired_of, step: int) -> None:
    fired, ranges = fired_of(2088), scene(2088)
    returns = mask(2088) & fired[(SENSOR.laser_of_ring >= 32).astype(int)]
    for expected, quick in itertools.product((None, guess(ranges)), (False, True)):
        coders = [PredictiveCoder(path) for path in PATHS]
        given_to = (returns, fired, SENSOR, step, LEVELS)
        data = {coder.encode(ranges, *given_to, expected=expected, quick=quick) for coder in coders}
        assert len(data) == 1
        for path in PATHS:
            came = PredictiveCoder(path).decode(*data, *given_to, expected=expected)
            check_bound(came, ranges, returns, step)

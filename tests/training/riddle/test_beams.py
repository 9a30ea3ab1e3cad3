"""If these fail, networks learn how the simulator reports its beams instead of how sensors do."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

pytest.importorskip("torch", reason="training needs torch: the extra `learned`")

from lidarcodec.errors import SourceError
from lidarcodec.frame import Frame
from lidarcodec.sources.simulator import SimulatorSource
from lidarcodec.training.riddle.beams import even_frames, even_turning
from lidarcodec.training.riddle.drives import frames_to_learn

HALF = 8


def growth_by_step(frame: Frame) -> dict[int, float]:
    """On smooth slanting surfaces: how much ranges grow after a step of 9 and after one of 18, against the usual."""
    found: dict[int, list[np.ndarray]] = {9: [], 18: []}
    ranges, steps = frame.range.astype(float), np.diff(frame.azimuth[0].astype(int)) % 36000
    for column in range(HALF, frame.width - HALF - 1):
        around = ranges[:, column - HALF : column + HALF + 2]
        grown = np.diff(around, axis=1)
        usual = np.median(grown, axis=1)
        smooth = (around > 0).all(axis=1) & (np.abs(usual) > 8) & (np.abs(grown - usual[:, None]).max(axis=1) < 30)
        found[int(steps[column])].append(grown[smooth, HALF] / usual[smooth])
    return {step: float(np.concatenate(values).mean()) for step, values in found.items()}


@pytest.mark.sweep
def test_ranges_grow_evenly_whatever_the_steps_that_packets_tell() -> None:
    source = SimulatorSource("city", 77, only=348)
    (plain,) = frames_to_learn_plainly(source)
    (even,) = even_frames(source, "packets", 1)
    assert growth_by_step(plain)[9] < 0.7  # if this is 1, the simulator does what a sensor does, and `beams` can go
    assert 0.9 < growth_by_step(even)[9] < 1.1
    assert np.array_equal(even.range > 0, plain.range > 0)
    moved = np.abs(even.range.astype(int) - plain.range)
    assert np.median(moved) <= 4
    assert moved.max() <= 200


def frames_to_learn_plainly(source: SimulatorSource) -> list[Frame]:
    """The frames as the packets say."""
    from lidarcodec.pipeline import frames_of

    return list(frames_of(source.packets(), source.sensor, "packets"))


def test_a_straight_line_is_found_again_in_its_steps() -> None:
    line: npt.NDArray[np.float64] = 1234.0 + 16.713 * np.arange(500, dtype=np.float64)
    assert np.abs(even_turning(line) - line).max() < 1e-6
    told: npt.NDArray[np.float64] = np.floor(line / 9) * 9 + 4.5
    assert np.abs(even_turning(told) - line).max() < 1.5
    assert np.abs(told - line).max() > 4
    for count in (0, 1, 2):
        assert even_turning(line[:count]).tolist() == line[:count].tolist()


def test_too_long_a_drive_is_refused() -> None:
    with pytest.raises(SourceError, match="287"):
        list(frames_to_learn(SimulatorSource("road", 1, 288), "packets"))

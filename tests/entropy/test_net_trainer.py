"""If these fail, a stream that learns gains less than it could in the time that it may take, or differs by machine."""

from __future__ import annotations

import numpy as np
import pytest

from lidarcodec.entropy import NetTrainer, PredictiveCoder, ReturnSamples, TrainSettings
from lidarcodec.network.networks import Net, quantised
from lidarcodec.network.shelf import native_nets, networks_of, weights_of
from lidarcodec.network.tiles import tiles_left
from tests.entropy.frames import all_fired, sensor
from tests.entropy.test_predictive_coder import LEVELS, guess, scene

SETTINGS = TrainSettings(mean=0.9, beside=0.0, batch=128)
BESIDE = 0.0
EFFORT = 4
"""Its networks have empty tiles."""
STEPS = 250


@pytest.fixture(scope="module")
def nets() -> list[Net]:
    return networks_of(weights_of(""), EFFORT)


@pytest.fixture(scope="module")
def samples(nets: list[Net]) -> list[ReturnSamples]:
    """Of two turns of a world that no network was trained on."""
    found = []
    for seed in (1, 2):
        ranges, taken = scene(120, seed), ReturnSamples(1.0, seed)
        every = np.ones(ranges.shape, bool)
        given = (ranges, every, all_fired(120), sensor(), 1, LEVELS)
        PredictiveCoder(nets=native_nets(nets)).encode(*given, expected=guess(ranges), samples=taken)
        found.append(taken)
    return found


def net_of(nets: list[Net]) -> Net:
    (net,) = (net for net in nets if net.expects)
    return net


@pytest.fixture
def trainer(nets: list[Net], samples: list[ReturnSamples]) -> NetTrainer:
    """Which learns from the first turn, and is measured on the second."""
    found = NetTrainer([layer.given for layer in net_of(nets).layers], SETTINGS, seed=1)
    for taken, held in zip(samples, (False, True), strict=True):
        found.add(taken, held=held)
    return found


def test_what_is_learned_holds_elsewhere(nets: list[Net], trainer: NetTrainer) -> None:
    before = trainer.cost(native_nets(nets), BESIDE)
    assert trainer.train(STEPS) == STEPS
    learned = quantised(True, net_of(nets).size, trainer.layers(), trainer.cases())
    after = trainer.cost(native_nets([learned if net.expects else net for net in nets]), BESIDE)
    assert after < before - 0.3


def test_steps_come_to_the_same_however_they_are_asked_for(
    nets: list[Net], samples: list[ReturnSamples], trainer: NetTrainer
) -> None:
    other = NetTrainer([layer.given for layer in net_of(nets).layers], SETTINGS, seed=1)
    other.add(samples[0], held=False)
    assert trainer.train(STEPS) == STEPS
    assert [other.train(steps) for steps in (1, 30, STEPS - 31)] == [1, 30, STEPS - 31]
    for (weights, bias), (same, alike) in zip(trainer.layers(), other.layers(), strict=True):
        np.testing.assert_array_equal(weights, same)
        np.testing.assert_array_equal(bias, alike)
    np.testing.assert_array_equal(trainer.cases(), other.cases())


def test_empty_tiles_stay_empty_and_all_others_move(nets: list[Net], trainer: NetTrainer) -> None:
    trainer.train(STEPS)
    for layer, (weights, _) in zip(net_of(nets).layers, trainer.layers(), strict=True):
        left = tiles_left(layer.weights)
        np.testing.assert_array_equal(tiles_left(weights), left)
        moved = weights - layer.weights * weights.dtype.type(2.0**-layer.shift)
        assert layer is net_of(nets).layers[-1] or (tiles_left(moved) == left).all()
    assert not tiles_left(net_of(nets).layers[0].weights).all()

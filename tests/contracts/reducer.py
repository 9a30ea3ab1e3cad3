"""What every reducer must do. `tests/reduction/test_contract.py` runs it over the table."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lidarcodec.frame import Frame
from lidarcodec.reduction import make_reducer, reduction
from lidarcodec.reduction.table import example_of
from lidarcodec.sensor_model import Calibration, SensorModel
from lidarcodec.settings import StreamSettings
from tests.contracts import frames


def settings_of(name: str, **budget: object) -> StreamSettings:
    """Settings of a reduction, with its example of an argument, and without a budget if it takes none."""
    return StreamSettings(reduction=example_of(name), **(budget if reduction(name).budgeted else {}))


def strange() -> dict[str, Frame]:
    """Frames in which there is little or nothing to choose, or nothing like what a sensor sees."""
    scene = frames.scene(20)
    lonely = np.zeros_like(scene.range)
    lonely[17] = scene.range[17]
    same = np.where(scene.range > 0, np.uint16(5000), np.uint16(0))
    rng = np.random.default_rng(5)
    wild = SensorModel("HDL-64E", Calibration(rng.integers(-(2**31), 2**31, (11, 64)).astype(np.int32)))
    upright = SensorModel("HDL-64E", Calibration.from_values({"vert_correction_rad": np.linspace(1.6, 1.3, 64)}))
    return {
        "no returns": scene.with_(range=np.zeros_like(scene.range)),
        "one return": scene.with_(range=np.pad([[np.uint16(700)]], ((9, 54), (4, scene.width - 5)))),
        "one laser": scene.with_(range=lonely),
        "all at one distance": scene.with_(range=same),
        "standing sensor": scene.with_(azimuth=np.zeros_like(scene.azimuth)),
        "one column": scene.with_(
            range=scene.range[:, :1], intensity=scene.intensity[:, :1], azimuth=scene.azimuth[:, :1],
            fired=scene.fired[:, :1], side=None,
        ),
        "no columns": scene.with_(
            range=scene.range[:, :0], intensity=scene.intensity[:, :0], azimuth=scene.azimuth[:, :0],
            fired=scene.fired[:, :0], side=None,
        ),
        "noise": frames.noise(20),
        "three upper blocks for a lower": frames.three_to_one(12),
        "any calibration": replace(scene, sensor=wild),
        "all lasers upwards": replace(scene, sensor=upright),
    }  # fmt: skip


def check_budget(name: str) -> None:
    """A frame keeps what the budget says, exactly, or all of it; what is kept is what it was."""
    for budget in ({"keep_points": 1}, {"keep_points": 300}, {"keep_fraction": 0.5}, {"keep_points": 10**6}, {}):
        reducer = make_reducer(settings_of(name, **budget))
        for index, (what, frame) in enumerate(strange().items()):
            given = frame.with_(index=index, stamp_ns=frame.stamp_ns + index * 100_000_000)
            reduced = reducer.reduce(given)
            kept = int(reduced.valid.sum())
            if reduction(name).budgeted:
                assert kept == reducer.budget.of(given.points), (what, budget)
            assert not (reduced.valid & ~given.valid).any(), what
            assert reduced.range is given.range
            assert (reduced.index, reduced.pose is None) == (given.index, given.pose is None)


def check_repeatable(name: str) -> None:
    """The same frames give the same result: from a fresh reducer, and after `reset`; another seed may give another."""
    stream = [frames.scene(30, index=index) for index in range(4)]
    reducer = make_reducer(settings_of(name, keep_points=500), seed=3)
    first = [reducer.reduce(frame).valid for frame in stream]
    reducer.reset()
    again = [reducer.reduce(frame).valid for frame in stream]
    fresh = make_reducer(settings_of(name, keep_points=500), seed=3)
    for one, two, frame in zip(first, again, stream, strict=True):
        np.testing.assert_array_equal(one, two)
        np.testing.assert_array_equal(one, fresh.reduce(frame).valid)


def check_reduced_before(name: str) -> None:
    """What an earlier stage has dropped stays dropped."""
    frame = frames.scene(30)
    halved = frame.with_(keep=(np.arange(frame.width) % 2 == 0) & np.ones((64, 1), np.bool_))
    reduced = make_reducer(settings_of(name, keep_points=200)).reduce(halved)
    assert not (reduced.valid & ~halved.valid).any()
    assert reduced.valid.any()


def check_ties(name: str) -> None:
    """Between equals a lot decides, and the seed is the lot: never the place in the frame, which would always drop the
    same side of the vehicle."""
    scene = frames.scene(30)
    alike = scene.with_(range=np.where(scene.range > 0, np.uint16(5000), np.uint16(0)), intensity=scene.intensity * 0)
    chosen = []
    for seed in (1, 2):
        reducers = [make_reducer(settings_of(name, keep_points=count), seed=seed) for count in (50, 200, 700, 1500)]
        chosen.append([reducer.reduce(alike).valid for reducer in reducers])
    for one, other in zip(*chosen, strict=True):
        assert one.sum() == other.sum()
    if reduction(name).budgeted:
        assert any((one != other).any() for one, other in zip(*chosen, strict=True))


def check_standing(name: str) -> None:
    """A vehicle that waits, with poses or without: the budget is kept frame after frame, and no choice drifts away."""
    frame = frames.scene(40)
    for pose in (None, np.eye(4)):
        reducer = make_reducer(settings_of(name, keep_points=400))
        for index in range(14):
            given = frame.with_(index=index, stamp_ns=frame.stamp_ns + index * 100_000_000, pose=pose)
            kept = int(reducer.reduce(given).valid.sum())
            assert not reduction(name).budgeted or kept == 400, index

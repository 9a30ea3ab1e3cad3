"""If these fail, networks that go on learning beside contexts learn something else than what streams are coded with."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="training needs torch: the extra `learned`")

from lidarcodec.frame import Frame  # noqa: E402
from lidarcodec.network.shelf import networks_of, weights_of  # noqa: E402
from lidarcodec.sources.simulator import SimulatorSource  # noqa: E402
from lidarcodec.training.riddle import nets  # noqa: E402
from lidarcodec.training.riddle.beside import BesideSamples  # noqa: E402
from lidarcodec.training.riddle.drives import frames_to_learn  # noqa: E402
from lidarcodec.training.riddle.extraction import LABELS, SAID, Rows, row_bytes  # noqa: E402
from lidarcodec.training.riddle.samples import Gathering, SampleStore  # noqa: E402


@pytest.fixture(scope="module")
def drive() -> list[Frame]:
    return list(frames_to_learn(SimulatorSource("road", 2, 8), "packets"))


@pytest.fixture(scope="module")
def taken(drive: list[Frame]) -> tuple[Rows, Rows]:
    return BesideSamples(networks_of(weights_of(""), 2), 5, 1500, np.random.default_rng(1)).of(drive)


@pytest.mark.sweep
def test_every_frame_is_a_key_frame_and_those_expect_for_which_contexts_are_warm(taken: tuple[Rows, Rows]) -> None:
    alone, expecting = taken
    assert alone.shape[1] == row_bytes(False)
    assert expecting.shape[1] == row_bytes(True)
    assert 8 * 1200 < len(alone) < 8 * 1800
    assert 3 * 1200 < len(expecting) < 3 * 1800


@pytest.mark.parametrize("expects", [False, True])
def test_contexts_know_what_the_network_does_not(taken: tuple[Rows, Rows], expects: bool) -> None:
    """With what they said a return costs less, and with what they said of others it costs more."""
    (net,) = [net for net in networks_of(weights_of(""), 2) if net.expects == expects]
    rows = taken[expects]
    silent, others = rows.copy(), rows.copy()
    silent[:, -2 * SAID :] = 0
    others[:, -2 * SAID :] = np.roll(rows[:, -2 * SAID :], 7, axis=0)
    costs = [nets.mean_bits_whole(net, [some]) for some in (rows, silent, others)]
    assert all(a < b for a, b in pairwise(costs)), costs


@pytest.mark.sweep
def test_rows_are_those_of_the_stream_behind_those_of_clips(tmp_path: Path) -> None:
    how = Gathering(seed=3, frame_rows=200)
    stores = [SampleStore(tmp_path / str(beside is None), "training", how, ["sim:road?frames=7"], [], beside)
              for beside in (None, weights_of(""))]  # fmt: skip
    for store in stores:
        store.gather(lambda _: None)
    without, with_it = (store.rows(True)[0] for store in stores)
    assert np.array_equal(with_it[: len(without)], without)
    assert not without[:, -2 * SAID :].any()
    assert with_it[len(without) :, -2 * SAID :].any(axis=1).all()
    assert LABELS == 4 + 2 * SAID
